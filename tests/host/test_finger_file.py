"""Recorded fingers as a person or a spreadsheet writes them."""

from pathlib import Path

import pytest

from smarttac_can.cli.nodes import read_finger

FINGER_HEADER = "t_s,x_mm,Fn_N\n"


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "finger.csv"
    path.write_text(f"{FINGER_HEADER}0.5,-38,10\r\n1.5,38,0\r\n", encoding="utf-8-sig")
    assert read_finger(path).at(1.0) == pytest.approx((0.0, 5.0))


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        ("0,0,0\n1,0\n", "line 3: 2 fields are not the 3 of the header"),
        ("0,0,0\n1,0,0,0\n", "line 3: 4 fields are not the 3 of the header"),
        ("0,-100,0\n1,0,0\n", "line 2: x_mm -100 is outside -38..38"),
        ("0,0,0\n1,0,10.5\n", "line 3: Fn_N 10.5 is outside 0..10"),
        ("0,0,0\n1,nan,0\n", "line 3: x_mm nan is outside -38..38"),
        ("-1,0,0\n1,0,0\n", "line 2: t_s -1 is outside 0..1e+09"),
        ("0.5,0,0\n1,0,0\n1,0,0\n", "line 4: t_s 1 is not after the 1 before it"),
        ("0,0,zero\n", "line 2: could not convert string to float: 'zero'"),
        ("0,0,0\n", "1 samples of a trajectory are fewer than 2"),
    ],
)
def test_what_is_wrong_is_named_by_line_in_the_units_of_the_file(
    rows: str, reason: str, tmp_path: Path
) -> None:
    path = tmp_path / "finger.csv"
    path.write_text(FINGER_HEADER + rows)
    with pytest.raises(ValueError) as caught:
        read_finger(path)
    assert str(caught.value) == f"{path}: {reason}"
