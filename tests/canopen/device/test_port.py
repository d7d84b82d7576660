from smarttac_can.canopen.device.port import NEVER, Clock


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


def test_timer_begins_anew_with_the_delay_it_was_given() -> None:
    clock, fired = Clock(), []
    once = clock.timer(lambda: fired.append("once"))
    again = clock.timer(lambda: fired.append("again"))
    once.start(30)
    again.start(20, periodic=True)
    clock.advance(10)
    once.restart()
    again.restart()
    clock.advance(19)
    assert fired == []
    clock.advance(1)
    assert (fired, once.due, again.due) == (["again"], 40, 50)
    once.stop()
    once.delay = 5
    once.restart()
    clock.advance(5)
    assert (fired, once.due) == (["again", "once"], NEVER)


def test_running_timer_follows_another_delay_from_its_start_on() -> None:
    clock, fired = Clock(), []
    timer = clock.timer(lambda: fired.append(clock.now))
    timer.follow(5)
    assert timer.due == NEVER
    timer.start(30)
    clock.advance(10)
    timer.follow(40)
    timer.follow(15)
    clock.advance(4)
    assert fired == []
    clock.advance(1)
    assert fired == [15]
