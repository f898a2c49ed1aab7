import pytest

from companion.core.filter.motion import EXPIRES_S, KEPT, Traffic
from companion.types.peers import ReceivedTraffic, TrafficSample
from companion.types.values import ZERO3
from companion.wire.messages import WireError, decode_traffic, encode, seal


def sample(east_m: float, age_s: float = 0.0) -> TrafficSample:
    return TrafficSample((east_m, 0.0, 50.0), (10.0, 0.0, 0.0), age_s, 5.0)


def test_the_nearest_are_kept_in_a_flood() -> None:
    traffic = Traffic()
    traffic.step(1.0, ZERO3, [ReceivedTraffic(1.0, f"n{k}", sample(10.0 * k)) for k in range(500)])
    assert sorted(traffic.newest) == sorted(f"n{k}" for k in range(KEPT))


def test_an_older_position_does_not_replace_a_newer_one() -> None:
    traffic = Traffic()
    traffic.step(
        5.0, ZERO3, [ReceivedTraffic(5.0, "a", sample(1.0)), ReceivedTraffic(5.0, "a", sample(2.0, age_s=3.0))]
    )
    assert traffic.newest["a"].sample.position_enu_m[0] == 1.0


def test_traffic_is_forgotten() -> None:
    traffic = Traffic()
    traffic.step(5.0, ZERO3, [ReceivedTraffic(5.0, "a", sample(1.0))])
    traffic.step(5.1 + EXPIRES_S, ZERO3, [])
    assert not traffic.newest


def test_a_sample_passes_the_wire() -> None:
    assert decode_traffic(encode(sample(3.0))) == sample(3.0)


@pytest.mark.parametrize("number", [float("nan"), float("inf"), 1e9, -1e9])
def test_numbers_out_of_range_are_refused(number: float) -> None:
    with pytest.raises(WireError):
        decode_traffic(encode(TrafficSample((number, 0.0, 0.0), (0.0, 0.0, 0.0))))
    with pytest.raises(WireError):
        decode_traffic(encode(TrafficSample((0.0, 0.0, 0.0), (number, 0.0, 0.0))))
    with pytest.raises(WireError):
        decode_traffic(seal(b"\x81\xa1x"))
