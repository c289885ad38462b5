"""How values are shown: the only place where scores are rounded."""

from datetime import UTC, datetime

from markupsafe import Markup

UNDEFINED = Markup('<span class="undefined">n/a</span>')

_KIB = 1024


def percent(value: float | None, digits: int = 1) -> str | Markup:
    """Show a score in [0, 1] in percent; undefined is "n/a", never 0."""
    return UNDEFINED if value is None else f"{100 * value:.{digits}f}"


def heat(value: float | None) -> str:
    """Name the shade of a score in [0, 1]: `h0` to `h10`; no shade for an undefined one."""
    return "" if value is None else f"h{min(10, max(0, int(10 * value + 0.5)))}"


def signed(value: float | None, digits: int = 1) -> str | Markup:
    """Show a difference of scores in percentage points, with its sign."""
    return UNDEFINED if value is None else f"{100 * value:+.{digits}f}".replace("-", "−")


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


FILTERS = {
    "percent": percent,
    "heat": heat,
    "signed": signed,
    "when": when,
    "day": day,
    "size": size,
    "plural": plural,
}
