"""Most readings of calibrated gauges by the data sheet are within twice u(mu)."""

from uncertainty import covered, readings_of


def test_expanded_uncertainty_covers_95_of_100_readings() -> None:
    """By design 95 %; a rectangular component, and a known scale, cover more."""
    calibrations, found, refused = readings_of(seed=7, plates=150)
    assert len(calibrations) + refused == 150
    everything = [row for rows in found.values() for row in rows]
    assert 0.94 < covered(everything) < 0.99
    without = [row._replace(uncertainty=0.7 * row.uncertainty) for row in everything]
    assert covered(without) < 0.93


def test_calibrate_refuses_most_untrimmed_gauges() -> None:
    """No object corrects S3 to S6, so a sum of them that is off by over 2 % is refused."""
    assert readings_of(seed=7, plates=40, trimmed=0.17)[2] > 25
