"""One row of a picture as shares of white, for a texture.

What is white follows the format's own definition: the largest sample of the depth (PNG 1 to 16 bit,
TIFF also with 0 as white), the colour of a palette entry, the luma of Rec. 601 of coded red, green
and blue. Nothing is interpreted further: no gamma, no colour profile. Pillow decodes; it reads
colours of 16 bits with 8, so that those are exact to 1/255.

The classes of the three formats are called directly. `PIL.Image.open` would depend on settings that
any other code in the process may change, such as its own limit of pixels.
"""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from smarttac_can.bench.given import whole
from smarttac_can.canopen.master.errors import BenchError
from smarttac_can.host.files import in_words, open_regular, too_large

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

MAX_PICTURE_BYTES: Final = 512 << 20
"""Largest file of a picture in bytes."""
MAX_PIXELS: Final = 50_000_000
"""Most pixels of a picture: 200 MB while it is decoded."""
MAX_WIDTH: Final = 65_535
"""Most pixels of a row, as in a JPEG."""
_LUMA: Final = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue by Rec. 601."""
_DAMAGE: Final = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    OSError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
"""What Pillow raises for damaged files; a lack of memory is none of them."""
_PHOTOMETRIC, _BITS, _EXTRA_SAMPLES, _SAMPLE_FORMAT = 262, 258, 338, 339
"""Tags of TIFF 6.0."""
_ORIENTATION: Final = 274
"""Tag of EXIF and TIFF: how the picture is turned before it is shown."""
_CURE: Final = "save it as grey or RGB, as PNG, JPEG or TIFF"


@in_words()
def read_row(path: Path, row: int) -> npt.NDArray[np.float64]:
    """Read a row of a PNG, JPEG or TIFF as numbers from 0 (black) to 1 (white).

    Parameters
    ----------
    path
        Picture of at most `MAX_PIXELS`, `MAX_WIDTH` wide.
    row
        Number of the row, counted from 0 at the top of the picture as it is shown.

    Raises
    ------
    ValueError
        If it is no such picture, is damaged or too large, has alpha or several pages, has samples
        without a white (signed, float), or no such row.
    OSError
        If the file is not a regular file, larger than `MAX_PICTURE_BYTES`, or cannot be read.
    BenchError
        If Pillow is missing.
    """
    number = whole("row", row)
    if find_spec("PIL") is None:
        raise BenchError("pictures need Pillow: pip install 'smarttac-can[pictures]'")
    with open_regular(path) as file:
        if file.seek(0, 2) > MAX_PICTURE_BYTES:
            raise too_large(path, MAX_PICTURE_BYTES)
        file.seek(0)
        start = file.read(8)
        file.seek(0)
        opened = _opener(start)
        if opened is None:
            raise ValueError(f"{path}: is no PNG, JPEG or TIFF")
        try:
            # What Pillow warns of, such as odd metadata, does not touch the pixels.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                with opened(file) as picture:
                    return _row(picture, number)
        except _RefusedError as error:
            raise ValueError(f"{path}: {error}") from None
        except _DAMAGE as error:
            said = str(error) or type(error).__name__
            raise ValueError(
                f"{path}: is damaged, or of a kind not read: {said}; {_CURE}"
            ) from error


class _RefusedError(Exception):
    """A sound picture of which no row is taken."""


def _opener(start: bytes) -> Callable[[Any], ImageFile] | None:
    """Return what opens the format of a file that begins so, None if it is none of the three."""
    # Loaded here because playing a texture needs no pictures.
    from PIL.JpegImagePlugin import jpeg_factory  # noqa: PLC0415
    from PIL.PngImagePlugin import PngImageFile  # noqa: PLC0415
    from PIL.TiffImagePlugin import TiffImageFile  # noqa: PLC0415

    if start == b"\x89PNG\r\n\x1a\n":
        return PngImageFile
    if start.startswith(b"\xff\xd8\xff"):
        return jpeg_factory
    if start[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
        return TiffImageFile
    return None


def _row(picture: ImageFile, row: int) -> npt.NDArray[np.float64]:
    from PIL import Image, ImageOps  # noqa: PLC0415
    from PIL import ImageFile as settings  # noqa: PLC0415, N813

    if settings.LOAD_TRUNCATED_IMAGES:
        raise _RefusedError(
            "PIL.ImageFile.LOAD_TRUNCATED_IMAGES is set, so that damage would not be seen; unset it"
        )
    white = _require_simple(picture)
    turned = picture.format != "TIFF" and picture.getexif().get(_ORIENTATION, 1) != 1
    # The luma of a JPEG is what it stores; red, green and blue would be rounded from it.
    picture.draft("L", None)
    try:
        picture.load()
    except Image.DecompressionBombError:  # of a TIFF only
        raise _RefusedError(
            f"has more pixels than PIL.Image.MAX_IMAGE_PIXELS, which is set to "
            f"{Image.MAX_IMAGE_PIXELS}; set it to {MAX_PIXELS}"
        ) from None
    shown = ImageOps.exif_transpose(picture) if turned else picture
    width, height = shown.size
    if width > MAX_WIDTH:
        raise _RefusedError(f"is {width} pixels wide, above {MAX_WIDTH}; make it smaller")
    if not 0 <= row < height:
        raise _RefusedError(f"row {row} is outside 0..{height - 1}")
    # Not by `crop`, which minds the limit of pixels that any other code may set.
    strip = shown.resize((width, 1), Image.Resampling.NEAREST, (0, row, width, row + 1))
    if strip.mode in ("P", "RGB", "YCbCr"):
        coded = np.asarray(strip.convert("RGB"), dtype=np.float64)[0] @ _LUMA
    else:
        coded = np.asarray(strip, dtype=np.float64)[0]
    share = coded / (1.0 if strip.mode == "1" else abs(white))
    inside: npt.NDArray[np.float64] = np.clip(share if white > 0.0 else 1.0 - share, 0.0, 1.0)
    return inside


def _require_simple(picture: ImageFile) -> float:
    """Return the sample that is white, negative if 0 is white; refuse what has no simple row."""
    width, height = picture.size
    if width * height > MAX_PIXELS:
        raise _RefusedError(
            f"has {width} x {height} pixels, above {MAX_PIXELS // 1_000_000} million; cut out the "
            "row, or make it smaller"
        )
    tags: Any = getattr(picture, "tag_v2", {})
    if picture.mode in ("LA", "La", "PA", "RGBA", "RGBa") or "transparency" in picture.info:
        raise _RefusedError("has alpha; flatten it, so that each pixel has one grey")
    if tags.get(_EXTRA_SAMPLES):
        raise _RefusedError("has alpha or other extra samples; flatten it")
    if getattr(picture, "n_frames", 1) != 1:
        raise _RefusedError("has several pages or frames; save the one to be played")
    if set(tags.get(_SAMPLE_FORMAT, (1,))) != {1} or picture.mode in ("I", "F"):
        raise _RefusedError(
            "has signed, float or 32-bit samples, of which none is white; read them with a "
            "library, and play them by Texture.over_position(x_mm, cof)"
        )
    if picture.mode not in ("1", "L", "P", "RGB", "YCbCr", "I;16", "I;16B"):
        raise _RefusedError(f"is in {picture.mode}, not in grey, a palette or RGB; {_CURE}")
    if not picture.mode.startswith("I;16"):
        return 255.0
    # Pillow turns a TIFF whose 0 is white up to 8 bits only.
    depth = tags.get(_BITS, (16,))[0]
    return float(2**depth - 1) * (-1.0 if tags.get(_PHOTOMETRIC, 1) == 0 else 1.0)
