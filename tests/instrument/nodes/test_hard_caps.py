"""Refusals of the nodes, whatever an EDS says: see `smarttac_can.instrument.nodes.hard_caps`."""

import re

import pytest

from smarttac_can.canopen.od.cia import Abort, AbortCode
from smarttac_can.canopen.od.eds import load_eds
from smarttac_can.host.files import read_eds
from smarttac_can.instrument.nodes.hard_caps import PLATE_CAPS, STIMULATOR_CAPS, Cap
from smarttac_can.instrument.nodes.plate_block import PlateBlock
from smarttac_can.instrument.nodes.plate_node import PlateNode
from smarttac_can.instrument.nodes.stimulator_block import StimulatorBlock
from smarttac_can.instrument.nodes.stimulator_node import StimulatorNode

STIMULATOR = read_eds("stimulator.eds")
PLATE = read_eds("plate.eds")
NODE_IDS = {STIMULATOR: 32, PLATE: 33}
MOST = {
    "Setpoint.Voltage": 20_000,
    "Setpoint.Amplitude": 3_000,
    "Limit.Voltage": 20_000,
    "Limit.Amplitude": 3_000,
    "Limit.Amplitude trip": 3_270,
    "Limit.Amplitude by drive": 6_000,
    "Limit.Temperature": 8_000,
    "Drive.Voltage": 20_000,
    "Vibration.Voltage": 20_000,
    "Stage.Voltage": 20_000,
}
"""Highest raw values: 200 V, 3 um, 3.27 um, 6 um, 80 degC."""
WRONG_UNITS = ("V", "0.01 V", "mV", "um", "0.1 degC", "1.0 ")
DEFAULT = {text: load_eds(text, node_id) for text, node_id in NODE_IDS.items()}
ALL = [(STIMULATOR, cap) for cap in STIMULATOR_CAPS] + [(PLATE, cap) for cap in PLATE_CAPS]
CAPPED = [(text, cap) for text, cap in ALL if cap.name in MOST]


def name_of(value: object) -> str:
    return value.name if isinstance(value, Cap) else ""


def edited(text: str, name: str, **keys: str | None) -> str:
    """The EDS with other values of some keys of an object, or without them."""
    entry = DEFAULT[text][name]
    subindex = f"sub{entry.subindex:X}" if "." in name else ""
    head, title, rest = text.partition(f"[{entry.index:04X}{subindex}]\n")
    assert title
    section, blank, rest = rest.partition("\n\n")
    lines = dict(line.split("=", 1) for line in section.splitlines()) | keys
    kept = "\n".join(f"{key}={value}" for key, value in lines.items() if value is not None)
    return head + title + kept + blank + rest


def refusal(text: str, changed: str) -> str:
    """Errors of both constructors for a changed EDS."""
    od = load_eds(changed, NODE_IDS[text])
    said = []
    for make in (PlateNode, PlateBlock) if text is PLATE else (StimulatorNode, StimulatorBlock):
        inside = (PlateBlock(DEFAULT[PLATE]),) if make is StimulatorNode else ()
        with pytest.raises(ValueError) as caught:
            make(od, *inside)
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert "\n" not in said[0]
    return said[0]


@pytest.mark.parametrize("text", [STIMULATOR, PLATE], ids=["stimulator", "plate"])
def test_everything_in_volts_is_capped_at_200_v(text: str) -> None:
    in_volts = {entry.name for entry in DEFAULT[text] if entry.unit.symbol.endswith("V")}
    in_volts -= {"Stage read-back"}  # A measured value may be anything, and is compared.
    assert in_volts == {cap.name for of, cap in CAPPED if of is text and "Voltage" in cap.name}
    assert all(DEFAULT[text][name].high == 20_000 for name in in_volts)


def test_every_object_that_sets_or_limits_is_capped() -> None:
    wanted = re.compile(r"(Setpoint|Limit)\.(Voltage|Amplitude|Temperature)|(Drive|Stage)\.Voltage")
    for text in (STIMULATOR, PLATE):
        names = {entry.name for entry in DEFAULT[text] if wanted.match(entry.name)}
        assert names <= {cap.name for of, cap in CAPPED if of is text}


@pytest.mark.parametrize(("text", "cap"), CAPPED, ids=name_of)
def test_the_cap_itself_passes_and_a_count_more_does_not(text: str, cap: Cap) -> None:
    most = MOST[cap.name]
    make = PlateBlock if text is PLATE else StimulatorBlock
    make(load_eds(edited(text, cap.name, HighLimit=str(most)), 1))
    said = refusal(text, edited(text, cap.name, HighLimit=str(most + 1)))
    assert said.startswith(f"{cap.name} has the HighLimit ")
    assert ", outside the hard cap 0.." in said
    assert "HighLimit" in refusal(text, edited(text, cap.name, HighLimit=None))


@pytest.mark.parametrize(("text", "cap"), CAPPED, ids=name_of)
def test_a_default_or_lowest_value_outside_is_refused(text: str, cap: Cap) -> None:
    above = str(MOST[cap.name] + 1)
    # A default above its limit is only odd in an EDS, and is in force all the same.
    assert "has the DefaultValue" in refusal(text, edited(text, cap.name, DefaultValue=above))
    assert "has the DefaultValue" in refusal(text, edited(text, cap.name, ParameterValue=above))
    below = edited(text, cap.name, DataType="0x0004", LowLimit="-1")
    assert "has the LowLimit -" in refusal(text, below)


@pytest.mark.parametrize(("text", "cap"), CAPPED, ids=name_of)
def test_a_limit_that_grows_with_the_node_id_is_refused(text: str, cap: Cap) -> None:
    formula = f"$NODEID+{MOST[cap.name] - 127}"
    assert "node-ID" in refusal(text, edited(text, cap.name, HighLimit=formula))


@pytest.mark.parametrize(
    ("text", "cap", "unit"),
    [(text, cap, WRONG_UNITS[n % len(WRONG_UNITS)]) for n, (text, cap) in enumerate(ALL)],
    ids=name_of,
)
def test_another_unit_factor_or_type_is_refused(text: str, cap: Cap, unit: str) -> None:
    own = cap.name.rpartition(".")[2]
    said = refusal(text, edited(text, cap.name, ParameterName=f"{own} [{unit}]"))
    assert said.startswith(f"{cap.name} has the unit [")
    assert "has the unit []" in refusal(text, edited(text, cap.name, ParameterName=own))
    real = edited(text, cap.name, DataType="0x0008")
    assert refusal(text, real) == f"{cap.name} is REAL32, not an integer"
    words = edited(text, cap.name, DataType="0x0009", LowLimit=None, HighLimit=None)
    assert refusal(text, words) == f"{cap.name} is VISIBLE_STRING, not an integer"


@pytest.mark.parametrize(("text", "cap"), ALL, ids=name_of)
def test_an_object_that_is_left_out_is_refused(text: str, cap: Cap) -> None:
    missing = edited(text, cap.name, ParameterName="Something else")
    assert refusal(text, missing) == f"{cap.name!r} is not in the EDS"


@pytest.mark.parametrize(
    ("text", "index", "subindex", "last", "beyond"),
    [
        (STIMULATOR, 0x2041, 7, 8000, 8001),
        (STIMULATOR, 0x2041, 8, 4000, 4001),
        (STIMULATOR, 0x2041, 9, 1000, 1001),
        *((STIMULATOR, index, 5, 1, 0) for index in (0x1404, 0x1405, 0x1406)),
        (PLATE, 0x1400, 5, 100, 101),
    ],
)
def test_limits_of_forces_and_deadlines_have_an_end(
    text: str, index: int, subindex: int, last: int, beyond: int
) -> None:
    entry = DEFAULT[text].entry(index, subindex)
    entry.check(last)
    with pytest.raises(Abort) as refused:
        entry.check(beyond)
    assert refused.value.code == (AbortCode.TOO_HIGH if beyond > last else AbortCode.TOO_LOW)


def test_foreign_plate_node_does_not_raise_the_hard_caps() -> None:
    od = load_eds(edited(STIMULATOR, "Drive.Voltage", HighLimit="50000"), 32)
    with pytest.raises(ValueError, match=r"^Drive\.Voltage has the HighLimit"):
        StimulatorNode(od, plate_node_id=33)


@pytest.mark.parametrize(
    ("name", "high"), [("Mode", 6), ("Friction law", 3), ("Controller.Vibration law", 2)]
)
def test_a_mode_or_law_that_there_is_not_is_refused(name: str, high: int) -> None:
    od = load_eds(STIMULATOR, 32)
    od[name].high = high
    StimulatorBlock(od)
    od[name].high = high + 1
    with pytest.raises(ValueError, match=f"{name} has the HighLimit {high + 1}, above {high}"):
        StimulatorBlock(od)
