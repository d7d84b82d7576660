"""The pace of a node's process: options that are refused, and what follows from a refusal."""

import pytest
from click.testing import CliRunner

from smarttac_can.cli import main, process
from smarttac_can.cli.process import Pace
from smarttac_can.cli.shared import BusChoice

VIRTUAL = ("--interface", "virtual", "--channel", "pace")
CURES = ["real time: one thing is refused", "real time: another is refused"]
SLEEPY = "real time: processors sleep"


@pytest.mark.parametrize("command", ["node", "plate"])
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("--realtime 0", "0 is not in the range 1<=x<=99"),
        ("--realtime 100", "100 is not in the range 1<=x<=99"),
        ("--realtime x", "'x' is not a valid integer"),
        ("--cpu 0", "--cpu is for --realtime PRIORITY: none is given"),
        ("--cpu 0 --lockstep", "--cpu is for --realtime PRIORITY: none is given"),
        ("--realtime 10 --cpu -1", "-1 is not in the range x>=0"),
        ("--realtime 10 --lockstep", "--realtime follows the clock, --lockstep does not"),
        ("--realtime 10 --lockstep --cpu 0", "--realtime follows the clock, --lockstep does not"),
    ],
)
def test_usage_errors(
    command: str, options: str, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("asked for, or run")

    monkeypatch.setattr(process, "request_real_time", refuse)
    monkeypatch.setattr("smarttac_can.cli.nodes.run_in_process", refuse)
    result = CliRunner().invoke(main, [command, *VIRTUAL, *options.split()])
    assert result.exit_code == 2
    assert result.stdout == ""
    *usage, line = result.stderr.splitlines()
    assert line.startswith("Error: ")
    assert says in line
    assert [words.split()[0] for words in usage if words] == ["Usage:", "Try"]


def test_lockstep_is_the_only_pace_of_a_device_without_a_loop() -> None:
    result = CliRunner().invoke(main, ["device", *VIRTUAL, "--realtime", "10"])
    assert result.exit_code == 2
    assert "No such option" in result.stderr


@pytest.mark.parametrize("refused", [[], CURES[:1], CURES])
@pytest.mark.parametrize("command", ["node --plate-node 33", "plate"])
@pytest.mark.parametrize("sleepy", [[], [SLEEPY]])
def test_what_is_refused_is_said_and_the_deadline_stays_that_of_the_eds(
    command: str, refused: list[str], sleepy: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int | None] | str] = []
    deadlines: list[list[int]] = []

    def request(priority: int, cpu: int | None) -> list[str]:
        asked.append((priority, cpu))
        return refused

    def keep_awake() -> list[str]:
        asked.append("awake")
        return sleepy

    def run(name: str, node: object, *_: object) -> None:
        entries = node.block.deadline._entries if name == "stimulator" else [node._deadline]
        deadlines.append([entry.value for entry in entries])

    monkeypatch.setattr(process, "request_real_time", request)
    monkeypatch.setattr(process, "keep_processors_awake", keep_awake)
    monkeypatch.setattr(process, "SHORT_DEADLINE_MS", 7)
    monkeypatch.setattr("smarttac_can.cli.nodes.run_in_process", run)
    for options in ("", "--realtime 42", "--realtime 42 --cpu 1", "--lockstep"):
        result = CliRunner().invoke(main, [*command.split(), *VIRTUAL, *options.split()])
        assert (result.exit_code, result.stdout) == (0, "")
        said = (refused or sleepy) if "--realtime" in options else []
        assert result.stderr.splitlines() == said
    awake = [] if refused else ["awake"]
    assert asked == [(42, None), *awake, (42, 1), *awake]
    ordinary, *real_time, lockstep = deadlines
    assert set(lockstep) == {7}
    assert 7 not in ordinary
    assert real_time == [ordinary if refused else lockstep] * 2


def test_pace_of_an_ordinary_process_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(process, "request_real_time")
    monkeypatch.delattr(process, "keep_processors_awake")
    assert Pace().begin() is None
    assert Pace(lockstep=True).begin() == 3


@pytest.mark.parametrize(
    ("interface", "channel", "where"),
    [
        ("udp_multicast", "239.74.163.2", "udp_multicast:239.74.163.2"),
        ("udp_multicast", None, "udp_multicast"),
        (None, None, "the bus of python-can's configuration"),
    ],
)
def test_what_a_bus_is_called(interface: str | None, channel: str | None, where: str) -> None:
    assert BusChoice(interface, channel, None, {}).where == where
