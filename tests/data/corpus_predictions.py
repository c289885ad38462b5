"""The corpus of prediction files: each accepted or refused for one reason. All are for the image `IMAGE`."""

from collections.abc import Iterator

Case = tuple[str, str, bytes]
"""Name, codes joined by "+" (none for silence), bytes."""

IMAGE = "berlin_000000_000019"


def box(
    *,
    label: str = '"car"',
    score: str = "0.9",
    amodal: str = "[900, 400, 100, 80]",
    modal: str | None = "[905, 400, 90, 80]",
    center: str = "[20.5, 1.25, 0.8]",
    dimensions: str = "[4.5, 1.8, 1.5]",
    rotation: str = "[1.0, 0.0, 0.0, 0.0]",
    more: str = "",
) -> str:
    """Write one box; every value is JSON text, so that it can be anything."""
    rectangles = f'"amodal": {amodal}' + ("" if modal is None else f', "modal": {modal}')
    space = f'"center": {center}, "dimensions": {dimensions}, "rotation": {rotation}'
    return f'{{"label": {label}, "score": {score}, "2d": {{{rectangles}}}, "3d": {{{space}}}{more}}}'


def document(*boxes: str, more: str = "") -> bytes:
    """Write a file."""
    return f'{{"objects": [{", ".join(boxes)}]{more}}}'.encode()


def accepted() -> Iterator[Case]:
    """Yield what is valid, with the warnings and notes it gives."""
    yield "empty_image", "no_boxes", b'{"objects": []}'
    yield "empty_image_spaced", "no_boxes", b' \t\r\n{ "objects" : [ ] } \n'
    yield "one_box", "", document(box())
    yield "amodal_only", "", document(box(modal=None))
    yield "amodal_only_mixed", "", document(box(modal=None), box())
    yield "integers", "", document(box(score="1", center="[20, 1, 1]", dimensions="[4, 2, 1]", rotation="[1, 0, 0, 0]"))
    yield "exponents", "", document(box(score="9e-1", center="[2.05E+1, 125e-2, 8.0e-1]"))
    yield "many_decimals", "", document(box(score="0.12345678901234567890123456789012345678901234567890"))
    yield "score_bounds", "", document(box(score="0"), box(score="1.0"), box(score="-0.0"))
    yield "size_bounds", "", document(box(dimensions="[0.01, 100, 1e2]"))
    yield "center_bounds", "", document(box(center="[10000, 0, 0]"), box(center="[0, -10000.0, 0]"))
    yield "box_of_no_size", "", document(box(amodal="[5, 5, 0, 0]", modal="[5, 5, 0, 0]"))
    yield "negative_corner", "", document(box(amodal="[-5.5, -6, 9, 9]"))
    yield "tiny_numbers", "", document(box(score="1e-400", rotation="[1, 1e-320, 0, 0]"))
    yield (
        "all_classes",
        "",
        document(*(box(label=f'"{label}"') for label in ("car", "truck", "bus", "train", "motorcycle", "bicycle"))),
    )
    yield "escaped_label", "", document(box(label='"c\\u0061r"'))
    yield (
        "ground_truth_keys",
        "",
        document(
            box(more=', "instanceId": 26000, "occlusion": 0.0, "truncation": 0.25'),
            more=', "imgWidth": 2048, "imgHeight": 1024, "sensor": {"fx": 2262.5, "list": [[1, 2], [3]]}, "ignore": []',
        ),
    )
    yield "extra_key_with_colon", "", document(box(more=', "time": "12:30:00", "url": "a:b"'))
    yield "extra_key_escaped", "", document(box(more=', "a\\"b\\\\": {"\\u0022": ":"}'))
    yield "extra_key_null", "", document(box(more=', "track": null, "tags": ["x", true, false, {}]'))
    yield "extra_key_long_integer", "", document(box(more=f', "id": {"9" * 18}'))
    yield "extra_keys_without_modal", "", document(box(modal=None, more=', "id": 1'), box(modal=None))
    yield "nested_31_levels", "no_boxes", document(more=', "deep": ' + "[" * 31 + "]" * 31)
    yield "unicode_extra", "no_boxes", document(more=', "note": "größe \N{SNOWMAN} \\ud83d\\ude00"')
    yield "unnormalised_rotation", "rotation_not_normalised", document(box(rotation="[2, 0, 0, 0]"), box())
    yield "rounded_rotation", "rotation_not_normalised", document(box(rotation="[0.71, 0, 0, 0.71]"))
    yield "slightly_rounded_rotation", "", document(box(rotation="[0.7071, 0, 0, 0.7071]"))
    yield "caravan", "unevaluated_label", document(box(label='"caravan"'), box(), box(label='"trailer"'))
    yield (
        "citypersons_keys",
        "citypersons_keys",
        document(box(modal='[1, 1, 1, 1], "bbox": [1, 2, 3, 4], "bboxVis": [1, 2, 3, 4]')),
    )
    yield "one_thousand_boxes", "", document(*[box(), box(score="0.8")] * 500)


_NOT_JSON: dict[str, bytes] = {
    "array_1_true_without_comma": b"[1 true]",
    "array_colon_instead_of_comma": b'["": 1]',
    "array_comma_after_close": b'[""],',
    "array_comma_and_number": b"[,1]",
    "array_double_comma": b"[1,,2]",
    "array_double_extra_comma": b'["x",,]',
    "array_extra_close": b'["x"]]',
    "array_extra_comma": b'["",]',
    "array_incomplete": b'["x"',
    "array_inner_without_comma": b"[3[4]]",
    "array_items_by_semicolon": b"[1;2]",
    "array_just_comma": b"[,]",
    "array_just_minus": b"[-]",
    "array_newline_unclosed": b'["a",\n4\n,1,',
    "array_number_and_several_commas": b"[1,,]",
    "array_spaces_vertical_tab": b"[\x0ba]",
    "array_star_inside": b"[*]",
    "array_unclosed": b"[1",
    "array_unclosed_trailing_comma": b"[1,",
    "incomplete_false": b"[fals]",
    "incomplete_null": b"[nul]",
    "incomplete_true": b"[tru]",
    "number_plus": b"[+1]",
    "number_double_sign": b"[++1234]",
    "number_minus_01": b"[-01]",
    "number_minus_2_dot": b"[-2.]",
    "number_dot_2e3": b"[.2e-3]",
    "number_0e": b"[0e]",
    "number_0e_plus": b"[0e+]",
    "number_0_3e": b"[0.3e]",
    "number_1_000": b"[1 000.0]",
    "number_1eE2": b"[1eE2]",
    "number_2_e3": b"[2.e3]",
    "number_9_e_plus": b"[9.e+]",
    "number_hex": b"[0x42]",
    "number_leading_zero": b"[012]",
    "number_neg_real_without_int": b"[-.123]",
    "number_real_garbage": b"[1.2a-3]",
    "number_full_width_digit": "[\N{FULLWIDTH DIGIT ONE}]".encode(),
    "number_underscore": b"[1_000]",
    "number_starting_dot": b"[.123]",
    "number_u_inf": b"[inf]",
    "number_minus_sign_with_space": b"[- 1]",
    "object_bad_value": b'["x", truth]',
    "object_bracket_key": b'{[: "x"}',
    "object_comma_instead_of_colon": b'{"x", null}',
    "object_double_colon": b'{"x"::"b"}',
    "object_emoji": "{\N{SNOWMAN}}".encode(),
    "object_garbage_at_end": b'{"a":"a" 123}',
    "object_key_single_quotes": b"{'a': 0}",
    "object_missing_colon": b'{"a" b}',
    "object_missing_key": b'{:"b"}',
    "object_missing_semicolon": b'{"a" "b"}',
    "object_missing_value": b'{"a":',
    "object_no_colon": b'{"a"',
    "object_non_string_key": b"{1:1}",
    "object_several_trailing_commas": b'{"id":0,,,,,}',
    "object_trailing_comma": b'{"id":0,}',
    "object_trailing_comment": b'{"a":"b"}/**/',
    "object_trailing_slash": b'{"a":"b"}//',
    "object_two_commas": b'{"a":"b",,"c":"d"}',
    "object_unquoted_key": b'{a: "b"}',
    "object_unterminated_value": b'{"a":"a',
    "object_with_single_string": b'{ "foo" : "bar", "a" }',
    "single_space": b" ",
    "string_incomplete_escape": b'["\\"]',
    "string_incomplete_surrogate": b'["\\uD834\\uDd"]',
    "string_escape_x": b'["\\x00"]',
    "string_escaped_tab": b'["\\\t"]',
    "string_bad_unicode_escape": b'["\\uqqqq"]',
    "string_control_character": b'["a\x00a"]',
    "string_unescaped_newline": b'["new\nline"]',
    "string_unescaped_tab": b'["\t"]',
    "string_single_quote": b"['single quote']",
    "string_without_quotes": b"[\\n]",
    "string_unterminated": b'["asd',
    "string_with_trailing_garbage": b'""x',
    "structure_angle_brackets": b"<.>",
    "structure_array_with_extra_close": b"[1]x",
    "structure_capitalised_true": b"[True]",
    "structure_close_unopened": b"1]",
    "structure_comma_instead_of_closing_brace": b'{"x": true,',
    "structure_double_array": b"[][]",
    "structure_end_array": b"]",
    "structure_lone_open_bracket": b"[",
    "structure_no_data": b"",
    "structure_null_byte_outside_string": b"[\x00]",
    "structure_number_with_trailing_garbage": b"2@",
    "structure_object_followed_by_closing": b"{}}",
    "structure_open_array_comma": b"[,",
    "structure_open_array_object": b'[{"":' * 5,
    "structure_open_object_string_with_apostrophes": b"{'a'",
    "structure_single_star": b"*",
    "structure_trailing_hash": b'{"a":"b"}#{}',
    "structure_uescaped_line_feed": b'[\\u000A""]',
    "structure_unclosed_object": b'{"asd":"asd"',
    "structure_whitespace_form_feed": b"[\x0c]",
    "structure_whitespace_no_break_space": "[\N{NO-BREAK SPACE}]".encode(),
    "structure_word_joiner": "[\N{WORD JOINER}]".encode(),
    "structure_yaml": b"objects:\n  - label: car\n",
    "structure_json_lines": b'{"objects": []}\n{"objects": []}\n',
}
"""Texts in the manner of JSONTestSuite's n_ cases, each in itself and as an extra value of an otherwise good file."""


def refused() -> Iterator[Case]:
    """Yield everything else."""
    yield from _not_json()
    yield from _bad_numbers()
    yield from _bad_shapes()
    yield from _bad_values()


def _not_json() -> Iterator[Case]:
    for name, text in _NOT_JSON.items():
        yield f"n_{name}", "invalid_json", text
    for name in ("array_double_comma", "number_leading_zero", "incomplete_true", "string_control_character"):
        hidden = b'{"objects": [], "extra": ' + _NOT_JSON[name] + b"}"
        yield f"n_extra_{name}", "invalid_json", hidden
    yield "n_string_lone_surrogate", "invalid_json", document(more=', "x": "\\ud800"')
    yield "n_structure_100000_opening_arrays", "nested_too_deeply", b"[" * 100_000
    yield "n_structure_deep_object", "nested_too_deeply", b'{"objects": ' * 5000
    yield "nested_33_levels", "nested_too_deeply", document(more=', "deep": ' + "[" * 32 + "]" * 32)
    yield (
        "nested_inside_string_and_out",
        "nested_too_deeply",
        document(more=', "\\"[[": "]]]]", "x": ' + "[" * 60 + "]" * 60),
    )
    yield "byte_order_mark", "byte_order_mark", b"\xef\xbb\xbf" + document()
    yield "utf16", "invalid_utf8", document().decode().encode("utf-16")
    yield "latin1", "invalid_utf8", document(more=', "note": "größe"').decode().encode("latin-1")
    yield "overlong_utf8", "invalid_utf8", b'{"objects": [], "x": "\xc0\xaf"}'
    yield "surrogate_utf8", "invalid_utf8", b'{"objects": [], "x": "\xed\xa0\x80"}'
    yield "utf8_cut", "invalid_utf8", b'{"objects": [], "x": "\xe2\x82"}'
    yield "key_not_utf8", "invalid_utf8", b'{"objects": [], "\xff": 1}'


def _bad_numbers() -> Iterator[Case]:
    for name, number in (("nan", "NaN"), ("infinity", "Infinity"), ("minus_infinity", "-Infinity"), ("1e999", "1e999")):
        yield f"score_{name}", "number_not_finite", document(box(score=number))
        yield f"center_{name}", "number_not_finite", document(box(center=f"[{number}, 0, 0]"))
        yield f"dimension_{name}", "number_not_finite", document(box(dimensions=f"[1, {number}, 1]"))
        yield f"rotation_{name}", "number_not_finite", document(box(rotation=f"[1, 0, 0, {number}]"))
        yield f"modal_{name}", "number_not_finite", document(box(modal=f"[1, 0, 0, {number}]"))
        yield f"extra_{name}", "number_not_finite", document(box(more=f', "weight": {number}'))
    yield "score_minus_1e999", "number_not_finite", document(box(score="-1e999"))
    digits = "1" * 30
    yield "score_30_digits", "number_too_long", document(box(score=digits))
    yield "center_30_digits", "number_too_long", document(box(center=f"[1, -{digits}, 1]"))
    yield "amodal_30_digits", "number_too_long", document(box(amodal=f"[{digits}, 1, 1, 1]"))
    yield "rotation_30_digits", "number_too_long", document(box(rotation=f"[1, {digits}, 1, 1]"))
    yield "score_400_digits", "number_too_long", document(box(score="1" * 400))
    yield "score_10000_digits", "number_too_long", document(box(score="1" * 10_000))
    for name, value in (
        ("true", "true"),
        ("false", "false"),
        ("null", "null"),
        ("numeric_string", '"0.9"'),
        ("empty_string", '""'),
        ("array", "[0.9]"),
        ("object", '{"value": 0.9}'),
    ):
        yield f"score_{name}", "wrong_type", document(box(score=value))
        yield f"center_{name}", "wrong_type", document(box(center=f"[{value}, 0, 0]"))
    yield "rotation_string", "wrong_type", document(box(rotation='[1, "0", 0, 0]'))
    yield "amodal_boolean", "wrong_type", document(box(amodal="[true, 0, 0, 0]"))


def _bad_shapes() -> Iterator[Case]:
    for name, text, code in (
        ("root_array", b"[]", "wrong_type"),
        ("root_null", b"null", "wrong_type"),
        ("root_number", b"1", "wrong_type"),
        ("root_string", b'"objects"', "wrong_type"),
        ("root_empty", b"{}", "missing_key"),
        ("root_list_of_boxes", b"[" + box().encode() + b"]", "wrong_type"),
        ("objects_capitalised", b'{"Objects": []}', "missing_key"),
        ("objects_null", b'{"objects": null}', "wrong_type"),
        ("objects_object", b'{"objects": {}}', "wrong_type"),
        ("objects_string", b'{"objects": ""}', "wrong_type"),
        ("box_null", b'{"objects": [null]}', "wrong_type"),
        ("box_array", b'{"objects": [[]]}', "wrong_type"),
        ("box_number", b'{"objects": [1]}', "wrong_type"),
        ("box_empty", b'{"objects": [{}]}', "missing_key"),
    ):
        yield name, code, text
    good = box()
    for key in ("label", "score", "2d", "3d", "amodal", "center", "dimensions", "rotation"):
        yield f"no_{key}", "missing_key", document(good.replace(f'"{key}"', f'"{key}_"'))
    yield "no_modal_null", "wrong_type", document(box(modal="null"))
    for key in ("2d", "3d"):
        start = good.index(f'"{key}": ') + 6
        for name, value in (("null", "null"), ("array", "[1, 2, 3, 4]"), ("string", '"x"')):
            end = good.index("}", start) + 1
            yield f"{key}_{name}", "wrong_type", document(good[:start] + value + good[end:])
    for name, field, value in (
        ("center_two", "center", "[1, 2]"),
        ("center_four", "center", "[1, 2, 3, 4]"),
        ("center_none", "center", "[]"),
        ("dimensions_two", "dimensions", "[1, 2]"),
        ("rotation_three", "rotation", "[1, 0, 0]"),
        ("rotation_five", "rotation", "[1, 0, 0, 0, 0]"),
        ("amodal_three", "amodal", "[1, 2, 3]"),
        ("amodal_five", "amodal", "[1, 2, 3, 4, 5]"),
        ("modal_none", "modal", "[]"),
    ):
        yield name, "wrong_length", document(box(**{field: value}))
    for field in ("center", "dimensions", "rotation", "amodal", "modal"):
        yield f"{field}_is_object", "wrong_type", document(box(**{field: '{"x": 1}'}))
    yield "rotation_matrix", "wrong_length+wrong_type", document(box(rotation="[[1, 0, 0], [0, 1, 0], [0, 0, 1]]"))
    yield "twice_objects", "duplicate_key", b'{"objects": [], "objects": []}'
    yield "twice_score", "duplicate_key", document(box(more=', "score": 0.8'))
    yield "twice_score_escaped", "duplicate_key", document(box(more=', "scor\\u0065": 0.8'))
    yield "twice_modal", "duplicate_key", document(box(modal='[1, 1, 1, 1], "modal": [2, 2, 2, 2]'))
    yield (
        "twice_amodal_without_modal",
        "duplicate_key",
        document(box(modal=None, amodal='[1, 1, 1, 1], "amodal": [2, 2, 2, 2]')),
    )
    yield "twice_extra", "duplicate_key", document(more=', "x": 1, "x": 1')
    yield "twice_extra_inside", "duplicate_key", document(box(more=', "x": [{"y": 1, "z": 2, "y": 1}]'))
    yield "twice_empty_key", "duplicate_key", document(more=', "": 1, "": 1')
    yield "too_many_boxes", "too_many_boxes", document(*[box(modal=None)] * 1001)


def _bad_values() -> Iterator[Case]:
    for name, field, value, code in (
        ("label_capitalised", "label", '"Car"', "labels_capitalised+unknown_label"),
        ("label_plural", "label", '"cars"', "labels_capitalised+unknown_label"),
        ("label_space", "label", '"car "', "labels_capitalised+unknown_label"),
        ("label_empty", "label", '""', "unknown_label"),
        ("label_nul", "label", '"car\\u0000"', "unknown_label"),
        ("label_numeric_text", "label", '"26"', "labels_numeric+unknown_label"),
        ("label_other", "label", '"spaceship"', "unknown_label"),
        ("label_colons", "label", '"a:b:c"', "unknown_label"),
        ("label_terminal", "label", '"\\u001b[31mcar"', "unknown_label"),
        ("label_number", "label", "26", "labels_numeric+wrong_type"),
        ("label_null", "label", "null", "wrong_type"),
        ("label_array", "label", '["car"]', "wrong_type"),
        ("label_nan", "label", "NaN", "number_not_finite+wrong_type"),
        ("score_negative", "score", "-1e-9", "score_out_of_range"),
        ("score_above_one", "score", "1.0000001", "score_out_of_range"),
        ("score_percent", "score", "97.3", "score_out_of_range"),
        ("score_20_digits", "score", "1" * 20, "score_out_of_range"),
        ("center_far", "center", "[10001, 0, 0]", "center_out_of_range"),
        ("center_far_diagonally", "center", "[8000, 8000, 0]", "center_out_of_range"),
        ("center_enormous", "center", "[0, 0, -1e300]", "center_out_of_range"),
        ("dimension_zero", "dimensions", "[4, 0, 1]", "dimension_out_of_range"),
        ("dimension_minus_zero", "dimensions", "[4, -0.0, 1]", "dimension_out_of_range"),
        ("dimension_negative", "dimensions", "[-4, 1.8, 1.5]", "dimension_out_of_range"),
        ("dimension_two_negative", "dimensions", "[-4, -0.0001, 1.5]", "dimension_out_of_range"),
        ("dimension_tiny", "dimensions", "[4, 0.009, 1]", "dimension_out_of_range"),
        ("dimension_millimetres", "dimensions", "[4500, 1800, 1500]", "dimension_out_of_range"),
        ("rotation_zero", "rotation", "[0, 0, 0, 0]", "rotation_zero"),
        ("rotation_minus_zero", "rotation", "[-0.0, 0, 0, 0]", "rotation_zero"),
        ("rotation_vanishing", "rotation", "[1e-200, 0, 0, 0]", "rotation_zero"),
        ("rotation_enormous", "rotation", "[1e9, 0, 0, 0]", "rotation_out_of_range"),
        ("amodal_negative_width", "amodal", "[900, 400, -10, 80]", "box_negative_size"),
        ("amodal_negative_height", "amodal", "[900, 400, 10, -0.5]", "box_negative_size"),
        ("modal_negative_size", "modal", "[10, 10, -0.5, -0.5]", "box_negative_size"),
        ("modal_far", "modal", "[1e7, 10, 5, 5]", "box_out_of_range"),
        ("amodal_enormous", "amodal", "[0, 0, 1e300, 1]", "box_out_of_range"),
    ):
        yield name, code, document(box(), box(**{field: value}))
    yield (
        "everything_wrong",
        (
            "box_negative_size+dimension_out_of_range+labels_capitalised+missing_key+rotation_zero+score_out_of_range+unknown_label+wrong_length"
        ),
        document(
            box(label='"Car"', score="2", amodal="[1, 1, -1, 1]", dimensions="[0, 1, 1]"),
            box(center="[1]", rotation="[0, 0, 0, 0]").replace('"score"', '"confidence"'),
        ),
    )
