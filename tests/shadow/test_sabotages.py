"""The shadow finds what is broken on purpose."""

from __future__ import annotations

import pytest
from frozen import NEW, old
from pair import Difference
from sabotages import BEGIN, SABOTAGES, Sabotage, broken
from world import World


@pytest.mark.parametrize("sabotage", SABOTAGES, ids=lambda sabotage: sabotage.what)
def test_what_is_broken_is_found(sabotage: Sabotage) -> None:
    with broken(NEW, sabotage), pytest.raises(Difference) as found:
        World(old(), NEW, sabotage.setting).play([*BEGIN, *sabotage.script])
    assert found.value.what.startswith(sabotage.seen), str(found.value)
