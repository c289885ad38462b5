"""Numbers as the terminal and the pages show them."""

import pytest

from client.text_table import number, percent, points
from server.pages.formatting import signed


@pytest.mark.parametrize("value", [-0.0, -4e-6, 4e-6])
def test_what_rounds_to_zero_has_no_minus(value: float) -> None:
    """A loss of nothing, 0 with the sign turned, is no loss; neither is one too small for two digits."""
    assert (number(value), percent(value), points(value), signed(value)) == ("0.00", "0.00", "+0.00", "+0.0")


def test_a_loss_keeps_its_minus() -> None:
    """-0.0012 is -0.12 points."""
    assert (number(-1.5), percent(-0.0012), points(-0.0012), signed(-0.0012)) == ("-1.50", "-0.12", "-0.12", "−0.1")
