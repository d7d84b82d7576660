import pytest

from smarttac_can.science.plant.friction import bare_friction, friction_map
from smarttac_can.science.plant.subjects import SUBJECTS
from smarttac_can.science.population.compiled import compiled


def doubled(x):
    return 2.0 * x


def test_a_function_of_another_package_is_left_alone():
    with pytest.raises(Exception, match="doubled"):
        compiled(_calls_doubled)(1.0)


def _calls_doubled(x):
    return doubled(x)


@pytest.mark.sources
def test_compiled_function_equals_the_plain_one_and_leaves_it():
    friction = friction_map(SUBJECTS[0], 43390.0)
    fast = compiled(bare_friction)
    assert fast(friction, 0.5, 0.0) == pytest.approx(bare_friction(friction, 0.5, 0.0), rel=1e-15)
    assert bare_friction.__class__.__name__ == "function"
