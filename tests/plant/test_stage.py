"""A stage that is stuck obeys 0 V alone."""

from hypothesis import given, settings
from hypothesis import strategies as st

from smarttac_can.plant.stage import PowerStage

voltages = st.floats(0.0, 500.0) | st.just(0.0)


@given(stuck=voltages, told=voltages)
@settings(max_examples=50)
def test_it_puts_out_what_it_is_told_but_where_it_is_stuck(stuck, told):
    stage = PowerStage()
    assert stage.put_out(told) == told
    stage.stick(stuck)
    assert stage.put_out(told) == (0.0 if told == 0.0 else stuck or told)
    stage.stick(0.0)
    assert stage.put_out(told) == told
