from collections.abc import Iterator

import pytest

from smarttac_can.bench import Stimulator


@pytest.fixture(params=["local", "bus", "inside", "virtual"])
def bench(request: pytest.FixtureRequest) -> Iterator[Stimulator]:
    """A stimulator over each link; the last is the fixture that users get."""
    if request.param == "virtual":
        yield request.getfixturevalue("stimulator")
        return
    link = "local" if request.param == "local" else "bus"
    with Stimulator.simulate(link, plate_inside=request.param == "inside") as made:
        yield made
