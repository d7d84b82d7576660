"""A row of a picture is the share of white that its format defines, or is refused in a line."""

import io
import subprocess
import sys
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from picture_files import (
    GREY,
    GREY_ALPHA,
    PALETTE,
    RGB,
    RGB_ALPHA,
    chunk,
    png,
    tiff,
)
from PIL import Image, ImageFile

from smarttac_can.bench import BenchError, Texture
from smarttac_can.bench.pictures import MAX_PIXELS, read_row

DRAW = np.random.default_rng(7)
BYTE = 1.0 / 255.0
LUMA = np.array([0.299, 0.587, 0.114])


def grey(depth: int) -> np.ndarray:
    """Return two rows of samples, of which the second has black, white and any other."""
    samples = DRAW.integers(0, 2**depth, (2, 29))
    samples[1, :2] = 0, 2**depth - 1
    return samples


def row_of(data: bytes, path: Path, row: int = 1) -> np.ndarray:
    path.write_bytes(data)
    white = read_row(path, row)
    assert white.min() >= 0.0
    assert white.max() <= 1.0
    return white


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_png_in_grey_is_exact_at_every_depth(depth: int, tmp_path: Path) -> None:
    samples = grey(depth)
    white = row_of(png(samples, depth), tmp_path / "grey.png")
    assert white == pytest.approx(samples[1] / (2**depth - 1), abs=1e-12)


@pytest.mark.parametrize("depth", [8, 16])
def test_png_in_colour_is_the_luma_of_rec_601(depth: int, tmp_path: Path) -> None:
    samples = DRAW.integers(0, 2**depth, (2, 29, 3))
    samples[1, 0], samples[1, 1] = 0, 2**depth - 1
    white = row_of(png(samples, depth, RGB), tmp_path / "rgb.png")
    exact = samples[1] @ LUMA / (2**depth - 1)
    assert white == pytest.approx(exact, abs=1e-12 if depth == 8 else BYTE)
    assert white[:2].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_png_with_a_palette_is_the_luma_of_its_colours(depth: int, tmp_path: Path) -> None:
    palette = DRAW.integers(0, 256, (2**depth, 3))
    samples = grey(depth)
    white = row_of(png(samples, depth, PALETTE, palette), tmp_path / "palette.png")
    assert white == pytest.approx(palette[samples[1]] @ LUMA / 255, abs=1e-12)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("photometric", [0, 1])
@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_tiff_in_grey_is_exact_with_white_high_or_low(
    depth: int, photometric: int, order: str, tmp_path: Path
) -> None:
    samples = grey(depth)
    data = tiff(samples, depth, photometric, order=order)
    if (depth, photometric, order) == (16, 0, ">"):
        with pytest.raises(ValueError, match=r"is damaged, or of a kind not read: .*; save it as"):
            row_of(data, tmp_path / "grey.tif")
        return
    share = samples[1] / (2**depth - 1)
    white = row_of(data, tmp_path / "grey.tif")
    assert white == pytest.approx(share if photometric else 1.0 - share, abs=1e-12)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("depth", [8, 16])
def test_tiff_in_colour_is_the_luma_of_rec_601(depth: int, order: str, tmp_path: Path) -> None:
    samples = DRAW.integers(0, 2**depth, (2, 29, 3))
    white = row_of(tiff(samples, depth, 2, order=order), tmp_path / "rgb.tif")
    exact = samples[1] @ LUMA / (2**depth - 1)
    assert white == pytest.approx(exact, abs=1e-12 if depth == 8 else BYTE)


def test_tiff_with_a_palette_is_the_luma_of_its_colours(tmp_path: Path) -> None:
    palette = DRAW.integers(0, 256, (256, 3))
    samples = grey(8)
    white = row_of(tiff(samples, 8, 3, palette=palette), tmp_path / "palette.tif")
    assert white == pytest.approx(palette[samples[1]] @ LUMA / 255, abs=BYTE)


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", "packbits"])
@pytest.mark.parametrize(("kind", "depth"), [(np.uint8, 8), (np.uint16, 16)])
def test_tiff_of_a_microscope_is_read_compressed(
    compression: str, kind: type, depth: int, tmp_path: Path
) -> None:
    samples = grey(depth).astype(kind)
    file = io.BytesIO()
    Image.fromarray(samples).save(file, "TIFF", compression=compression)
    white = row_of(file.getvalue(), tmp_path / "wear.tif")
    assert white == pytest.approx(samples[1] / (2**depth - 1), abs=1e-12)


@pytest.mark.parametrize("mode", ["L", "RGB"])
@pytest.mark.parametrize("progressive", [False, True])
def test_jpeg_is_the_luma_that_it_stores(mode: str, progressive: bool, tmp_path: Path) -> None:
    ramp = np.tile(np.linspace(0, 255, 64).astype(np.uint8), (16, 1))
    colours = np.stack([ramp, ramp[:, ::-1], ramp // 2], axis=-1)
    file = io.BytesIO()
    pixels = ramp if mode == "L" else colours
    picture = Image.fromarray(pixels)
    picture.save(file, "JPEG", quality=100, subsampling=0, progressive=progressive)
    white = row_of(file.getvalue(), tmp_path / "texture.jpg", 5)
    exact = (pixels[5] if mode == "L" else pixels[5] @ LUMA) / 255
    assert white == pytest.approx(exact, abs=3 * BYTE)


@pytest.mark.parametrize("form", ["JPEG", "PNG", "TIFF"])
def test_picture_turned_by_its_exif_is_read_as_shown(form: str, tmp_path: Path) -> None:
    pixels = np.zeros((24, 40), np.uint8)
    pixels[:, :20] = 255
    exif = Image.Exif()
    exif[274] = 6
    path = tmp_path / f"turned.{form.lower()}"
    Image.fromarray(pixels).save(path, form, exif=exif)
    # A quarter turn to the right: the left side comes to the top.
    assert read_row(path, 5) == pytest.approx(np.ones(24), abs=0.02)
    assert read_row(path, 35) == pytest.approx(np.zeros(24), abs=0.02)


COLOUR = np.full((2, 9, 4), 255)
REFUSED = {
    "alpha.png": (png(COLOUR, 8, RGB_ALPHA), "has alpha; flatten it"),
    "alpha16.png": (png(COLOUR[..., :2] * 257, 16, GREY_ALPHA), "has alpha; flatten it"),
    "grey-alpha.png": (png(COLOUR[..., :2], 8, GREY_ALPHA), "has alpha; flatten it"),
    "key.png": (
        png(COLOUR[..., 0], 8, GREY, extra=chunk(b"tRNS", b"\0\1")),
        "has alpha; flatten it",
    ),
    "palette.png": (
        png(COLOUR[..., 0], 8, PALETTE, np.zeros((256, 3)), extra=chunk(b"tRNS", b"\0")),
        "has alpha; flatten it",
    ),
    "alpha.tif": (tiff(COLOUR, 8, 2, extra_samples=2), "has alpha; flatten it"),
    "extra.tif": (tiff(COLOUR, 8, 2, extra_samples=0), "has alpha or other extra samples"),
    "pages.tif": (tiff(COLOUR[..., 0], 8, pages=2), "has several pages or frames; save the one"),
    "signed.tif": (
        tiff(COLOUR[..., 0], 16, sample_format=2),
        "has signed, float or 32-bit samples, of which none is white",
    ),
    "signed8.tif": (
        tiff(COLOUR[..., 0], 8, sample_format=2),
        "has signed, float or 32-bit samples, of which none is white",
    ),
    "cmyk.tif": (tiff(COLOUR, 8, 5), "is in CMYK, not in grey, a palette or RGB; save it as grey"),
    "lab.tif": (tiff(COLOUR[..., :3], 8, 8), "is in LAB, not in grey"),
    "cut.png": (png(grey(8), 8)[:-30], "is damaged, or of a kind not read: "),
    "cut.tif": (tiff(grey(8), 8)[:60], "is damaged, or of a kind not read: "),
    "empty.png": (b"", "is no PNG, JPEG or TIFF"),
    "gif.png": (b"GIF89a\1\0\1\0", "is no PNG, JPEG or TIFF"),
    "low.png": (png(grey(8), 8), "row 2 is outside 0..1"),
    "high.png": (png(grey(8), 8), "row -1 is outside 0..1"),
    "wide.png": (png(np.zeros((1, 65_536), int), 8), "is 65536 pixels wide, above 65535"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_picture_without_one_grey_per_pixel_is_refused(name: str, tmp_path: Path) -> None:
    data, reason = REFUSED[name]
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ValueError) as refused:
        read_row(path, {"wide.png": 0, "low.png": 2, "high.png": -1}.get(name, 1))
    assert str(refused.value).startswith(f"{path}: {reason}")
    assert "\n" not in str(refused.value)


def test_jpeg_of_several_pictures_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "both.jpg"
    eye = Image.fromarray(np.zeros((8, 8), np.uint8))
    eye.save(path, "MPO", save_all=True, append_images=[eye])
    with pytest.raises(ValueError, match=r"both\.jpg: has several pages or frames"):
        read_row(path, 0)


@pytest.mark.parametrize("row", [1.0, None, True, slice(0, 2), "1", np.float64(1.0)])
def test_row_that_is_no_integer_is_refused(row: object, tmp_path: Path) -> None:
    path = tmp_path / "grey.png"
    path.write_bytes(png(grey(8), 8))
    with pytest.raises(ValueError, match=r"^row .* is no integer: give a whole number$"):
        Texture.from_picture(path, row, 0.3, 0.4)  # type: ignore[arg-type]
    assert Texture.from_picture(path, np.int64(1), 0.3, 0.4)  # type: ignore[arg-type]


@pytest.mark.parametrize(("width", "height"), [(20_000, 20_000), (MAX_PIXELS, 2), (8_000, 6_251)])
def test_picture_of_too_many_pixels_is_refused_unread(
    width: int, height: int, tmp_path: Path
) -> None:
    data = bytearray(png(np.zeros((1, 1), int), 8))
    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + bytes(data[24:29])
    data[12:33] = b"IHDR" + head + zlib.crc32(b"IHDR" + head).to_bytes(4, "big")
    path = tmp_path / "bomb.png"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=rf"has {width} x {height} pixels, above 50 million; cut"):
        read_row(path, 0)


def test_largest_picture_is_read_in_little_memory(tmp_path: Path) -> None:
    path = tmp_path / "large.png"
    Image.new("RGB", (8_000, 6_250), (255, 0, 0)).save(path, compress_level=1)
    code = (
        "import re, sys; from pathlib import Path\n"
        "from smarttac_can.bench.pictures import read_row\n"
        "print(read_row(Path(sys.argv[1]), 6249).mean())\n"
        # Not ru_maxrss, which has that of the process that started this one.
        "said = Path('/proc/self/status').read_text()\n"
        "print(int(re.search(r'VmHWM:\\s+(\\d+)', said)[1]) // 1024)"
    )
    command = [sys.executable, "-c", code, str(path)]
    mean, mb = subprocess.run(command, capture_output=True, check=True, text=True).stdout.split()
    assert float(mean) == pytest.approx(0.299)
    assert int(mb) < 400


def test_settings_of_pillow_change_no_texture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "grey.png"
    samples = grey(8)
    path.write_bytes(png(samples, 8))
    (tmp_path / "grey.tif").write_bytes(tiff(samples, 8))
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1)
    assert read_row(path, 1) == pytest.approx(samples[1] / 255)
    with pytest.raises(
        ValueError, match=r"PIL\.Image\.MAX_IMAGE_PIXELS, which is set to 1; set it"
    ):
        read_row(tmp_path / "grey.tif", 1)
    monkeypatch.setattr(ImageFile, "LOAD_TRUNCATED_IMAGES", True)
    with pytest.raises(ValueError, match=r"grey\.png: PIL\.ImageFile\.LOAD_TRUNCATED_IMAGES is se"):
        read_row(path, 1)


def test_damaged_pictures_are_read_or_refused_in_a_line(tmp_path: Path) -> None:
    file = io.BytesIO()
    Image.fromarray(grey(8).astype(np.uint8)).save(file, "JPEG")
    path = tmp_path / "damaged"
    said = 0
    for sound in (file.getvalue(), png(grey(16), 16), tiff(grey(8), 8)):
        for _ in range(150):
            data = bytearray(sound)
            for at in DRAW.integers(0, len(data), 3):
                data[at] = DRAW.integers(0, 256)
            path.write_bytes(data)
            with warnings.catch_warnings(record=True) as warned:
                warnings.simplefilter("always")
                try:
                    white = read_row(path, 1)
                    assert 0.0 <= white.min() <= white.max() <= 1.0
                except ValueError as error:
                    said += 1
                    assert "\n" not in str(error)
            assert not warned
    assert said > 50


def test_pictures_without_pillow_name_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("smarttac_can.bench.pictures.find_spec", lambda name: None)
    with pytest.raises(BenchError, match=r"^pictures need Pillow: pip install 'smarttac-can\[pic"):
        Texture.from_picture(tmp_path / "wood.png", 0, 0.2, 0.3)


def test_former_name_reads_the_same_picture(tmp_path: Path) -> None:
    path = tmp_path / "grey.png"
    path.write_bytes(png(grey(8), 8))
    assert Texture.from_png(path, 1, 0.2, 0.3) == Texture.from_picture(path, 1, 0.2, 0.3)
