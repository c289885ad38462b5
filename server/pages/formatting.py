"""How values are shown: the only place where scores are rounded."""

from datetime import UTC, datetime

from markupsafe import Markup

from evaluator.confidence import Interval

UNDEFINED = Markup('<span class="undefined">n/a</span>')

SMALLEST_P_VALUE = 0.005
"""A thousand resamples tell smaller ones apart only by chance."""

_KIB = 1024


def percent(value: float | None, digits: int = 1) -> str | Markup:
    """Show a score in [0, 1] in percent; undefined is "n/a", never 0."""
    return UNDEFINED if value is None else f"{100 * value:.{digits}f}"


def heat(value: float | None) -> str:
    """Name the shade of a score in [0, 1]: `h0` to `h10`; no shade for an undefined one."""
    return "" if value is None else f"h{min(10, max(0, int(10 * value + 0.5)))}"


def signed(value: float | None, digits: int = 1) -> str | Markup:
    """Show a difference of scores in percentage points, with its sign; what rounds to 0 has no minus."""
    return UNDEFINED if value is None else f"{100 * value:+z.{digits}f}".replace("-", "−")


def interval(value: Interval | None, digits: int = 1) -> str | Markup:
    """Show the bounds of a score's confidence interval in percent."""
    return UNDEFINED if value is None else f"{100 * value.lower:.{digits}f}–{100 * value.upper:.{digits}f}"


def signed_interval(value: Interval | None, digits: int = 2) -> str | Markup:
    """Show the bounds of a difference's confidence interval in percentage points."""
    return UNDEFINED if value is None else f"{signed(value.lower, digits)} to {signed(value.upper, digits)}"


def ranks(value: tuple[int, int] | None) -> str | Markup:
    """Show between which ranks a method may stand."""
    if value is None:
        return UNDEFINED
    best, worst = value
    return str(best) if best == worst else f"{best}–{worst}"


def p_value(value: float | None) -> str | Markup:
    """Show a p-value; below what the resamples can tell, only the bound."""
    if value is None:
        return UNDEFINED
    return f"{value:.3f}" if value >= SMALLEST_P_VALUE else f"< {SMALLEST_P_VALUE}"


def when(value: datetime | None) -> str | Markup:
    """Show a time in UTC, with the exact one for machines."""
    if value is None:
        return Markup("–")
    utc = value.astimezone(UTC)
    machine = utc.isoformat(timespec="seconds")
    return Markup('<time datetime="{}">{:%Y-%m-%d %H:%M} UTC</time>').format(machine, utc)


def day(value: datetime | None) -> str | Markup:
    """Show a date, with the exact time for machines."""
    if value is None:
        return Markup("–")
    utc = value.astimezone(UTC)
    return Markup('<time datetime="{}">{:%Y-%m-%d}</time>').format(utc.isoformat(timespec="seconds"), utc)


def size(count: int) -> str:
    """Show a number of bytes in binary units."""
    amount = float(count)
    for unit in ("B", "KiB", "MiB"):
        if amount < _KIB:
            return f"{amount:.0f} {unit}" if unit == "B" else f"{amount:.1f} {unit}"
        amount /= _KIB
    return f"{amount:.1f} GiB"


def plural(count: int, one: str, many: str | None = None) -> str:
    """Show a count with its noun."""
    return f"{count:,} {one if count == 1 else many or one + 's'}"


def sentence(message: str) -> str:
    """Make a sentence of the message of an error."""
    return f"{message[:1].upper()}{message[1:]}."


FILTERS = {
    "sentence": sentence,
    "percent": percent,
    "heat": heat,
    "signed": signed,
    "interval": interval,
    "signed_interval": signed_interval,
    "ranks": ranks,
    "p_value": p_value,
    "when": when,
    "day": day,
    "size": size,
    "plural": plural,
}
