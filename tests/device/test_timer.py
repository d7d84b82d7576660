from smarttac_can.device.timer import NEVER, Clock


def test_timers_fire_in_order_of_expiry_and_once() -> None:
    clock, fired = Clock(), []
    first, second = clock.timer(lambda: fired.append("a")), clock.timer(lambda: fired.append("b"))
    first.start(30)
    second.start(20, periodic=True)
    clock.advance(100)
    assert fired == ["b", "a"]
    assert (first.due, second.due) == (NEVER, 120)
    clock.advance(19)
    assert fired == ["b", "a"]
    clock.advance(1)
    assert fired == ["b", "a", "b"]


def test_one_timer_may_stop_another_that_is_also_due() -> None:
    clock, fired = Clock(), []
    second = clock.timer(lambda: fired.append("b"))
    first = clock.timer(second.stop)
    first.start(1)
    second.start(2)
    clock.advance(5)
    assert fired == []


def test_timer_started_by_another_fires_at_its_own_time() -> None:
    clock, fired = Clock(), []
    second = clock.timer(lambda: fired.append(clock.now))
    first = clock.timer(lambda: second.start(3))
    first.start(1)
    for _ in range(6):
        clock.advance(1)
    assert fired == [4]
