"""Frames that a client sent before it heard that the server had ended the transfer.

The server must not answer them, as the client would take a second answer for that to its next
request. And a segment of a block download that is taken for a request could write anything.
"""

from __future__ import annotations

from typing import Final

_LAST: Final = 0x80
_SEQUENCE: Final = 0x7F

# Command specifiers of a client; a request of a block transfer begins it if its low bits are 0.
_SEGMENTS: Final = (0, 3)
_BLOCK_UPLOAD: Final = 5
_BLOCK_DOWNLOAD: Final = 6


class LateSegments:
    """Segments of a block download that may come although the server has answered.

    A client that stops among them may begin anew with a command that equals the next number. It is
    then not heard, but is when it repeats the request.

    Parameters
    ----------
    number
        Of the next segment, 1..127; 0 if none is under way.
    aborted
        Whether the transfer is over: a sub-block that the client begins is late as well.

    Attributes
    ----------
    part
        Of the time-out, as a divisor, within which the next one comes.
    follows
        Number of the next one after those that came; 0 if none came, or no more will.
    """

    part: Final = 1

    def __init__(self, number: int = 0, *, aborted: bool = False) -> None:
        self.follows = 0
        self._number = number
        self._aborted = aborted

    def include(self, command: int) -> bool:
        """Tell whether a frame is the next of them; after one that is not, none is."""
        number = command & _SEQUENCE
        late = number > 0 and (number == self._number or (self._aborted and number == 1))
        self.follows = (number + 1) & _SEQUENCE if late and not command & _LAST else 0
        self._number = self.follows
        return late


class LateRequest:
    """The one request that a client of any other transfer may have sent before the abort.

    A client that sends a second one has not looked at the abort, and has to be told again.

    Attributes
    ----------
    part
        Of the time-out, as a divisor, within which it comes.
    """

    part: Final = 10

    def __init__(self) -> None:
        self._came = False

    def include(self, command: int) -> bool:
        """Tell whether a frame is that request: it goes on with a transfer, as the first."""
        specifier = command >> 5
        goes_on = (
            specifier in _SEGMENTS
            or (specifier == _BLOCK_UPLOAD and command & 3 != 0)
            or (specifier == _BLOCK_DOWNLOAD and command & 1 != 0)
        )
        late = goes_on and not self._came
        self._came = True
        return late
