"""Two processes share the images of a file: one reads them from the front, the other from the back, until they meet."""

import os
from collections.abc import Iterator, Sequence

_TURN_IMAGES = 4
"""Images read at a turn: little work, so that neither process waits long for the other's last turn."""

_MOST_TURNS = 4096
"""What an empty pipe holds on every system."""


class Turns:
    """The turns at reading a file's images that are left: one process takes them from the front, the other from the back.

    A pipe holds a byte for each; who reads it has the turn. No lock, which a process might take with it into death.
    """

    def __init__(self) -> None:
        """Make the pipe."""
        self._source, self._sink = os.pipe()
        os.set_blocking(self._source, False)

    def lay_out(self, images: int) -> None:
        """Begin anew with a file of so many images, while the other process waits for it."""
        self.end()
        os.write(self._sink, bytes(-(-images // _images_at_a_turn(images))))

    def end(self) -> None:
        """Leave no turn: there is nothing more to be read."""
        while self._is_mine():
            pass

    def take(
        self, assigned: Sequence[tuple[int, int]], taken: list[int], *, backwards: bool
    ) -> Iterator[tuple[int, int]]:
        """Yield images and their files turn by turn until none is left.

        Args:
            assigned: Of all images.
            taken: Receives how many images each turn had.
            backwards: From the last image to the first.
        """
        step = _images_at_a_turn(len(assigned))
        firsts = range(0, len(assigned), step)
        for first in reversed(firsts) if backwards else firsts:
            if not self._is_mine():
                return
            turn = assigned[first : first + step]
            taken.append(len(turn))
            yield from reversed(turn) if backwards else turn

    def _is_mine(self) -> bool:
        try:
            return bool(os.read(self._source, 1))
        except BlockingIOError:
            return False

    def close(self) -> None:
        """Close the pipe."""
        os.close(self._source)
        os.close(self._sink)


def _images_at_a_turn(images: int) -> int:
    return max(_TURN_IMAGES, -(-images // _MOST_TURNS))
