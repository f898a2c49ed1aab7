"""The vehicle model of a batch against that of sitl.vehicle and companion.core: random states, every branch."""

from math import radians

import numpy as np
import pytest

from companion.analysis.interaction import FloatArray
from companion.config.fleet import Envelope
from companion.core.control.setpoint import attitude_target, limit_acceleration
from companion.core.estimation.corrections import VelocityCorrection
from companion.core.estimation.wind import DisturbanceObserver, FlightSample
from companion.core.safety.limits import OutputLimiter, OutputLimits
from companion.geometry.airspace import Fence
from companion.geometry.frames import euler_from_quaternion, quaternion_from_euler
from companion.types.autopilot import AttitudeTarget
from lockstep_fleet import platoon
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.px4.autopilot import Px4
from sitl.batch.agents import AttitudeCommands
from sitl.batch.bodies import (
    AttitudeLoops,
    Bodies,
    euler_rad,
    product,
    quaternion_of_euler,
    quaternion_of_turns,
)
from sitl.batch.columns import columns_of
from sitl.batch.observers import DisturbanceObservers, VelocityCorrections
from sitl.vehicle.config import Airframe
from sitl.vehicle.control import AttitudeControl, AttitudeSetpoint
from sitl.vehicle.dynamics import Body, small_turn, turned
from stand_ins import Equations
from tests.bench.batch_models import RungeKutta

AIRFRAMES = [
    Airframe(),
    Airframe(mass_kg=2.0, inertia_kg_m2=(0.02, 0.03, 0.06), drag_n_per_m_s=0.0, motor_lag_s=0.02),
    Airframe(mass_kg=0.5, motor_lag_s=0.0),
]
COUNT = 30
WIND = (2.0, -1.0, 0.5)


def random_quaternions(random: np.random.Generator, count: int) -> FloatArray:
    quaternions = random.standard_normal((4, count))
    return quaternions / np.linalg.norm(quaternions, axis=0)


def random_states(random: np.random.Generator) -> FloatArray:
    states = random.standard_normal((17, COUNT)) * 3.0
    states[6:10] = random_quaternions(random, COUNT)
    return states


@pytest.mark.parametrize("runge_kutta", [False, True])
def test_bodies_move_as_in_the_stand_in(runge_kutta: bool) -> None:
    random = np.random.default_rng(1)
    of_column = random.integers(0, len(AIRFRAMES), COUNT)
    states, commands = random_states(random), random.standard_normal((4, COUNT)) * 5.0
    expected = []
    for column, kind in enumerate(of_column.tolist()):
        airframe = AIRFRAMES[kind]
        state, (thrust_n, *moments_n_m) = tuple(states[:, column].tolist()), commands[:, column].tolist()
        of_airframe = (airframe.mass_kg, airframe.inertia_kg_m2, airframe.drag_n_per_m_s, airframe.motor_lag_s)
        if runge_kutta:
            expected.append(Equations(*of_airframe, thrust_n, moments_n_m, WIND).after(state, DT_S))
        else:
            expected.append(Body(*of_airframe, DT_S).step(state, thrust_n, moments_n_m, WIND))
    bodies = Bodies(AIRFRAMES, of_column)
    (RungeKutta(bodies) if runge_kutta else bodies).step(states, commands, np.array(WIND)[:, None], DT_S)
    np.testing.assert_allclose(states.T, expected, rtol=1e-12, atol=1e-12)


def test_attitude_loops_respond_as_in_the_stand_in() -> None:
    random = np.random.default_rng(2)
    goal, measured = random_quaternions(random, COUNT), random_quaternions(random, COUNT)
    measured[:, 0], goal[:, 0] = (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)  # upside down
    measured[:, 1] = goal[:, 1]
    rates = random.standard_normal((3, COUNT))
    inertia = np.repeat([[0.02], [0.03], [0.05]], COUNT, axis=1)
    out = np.empty((3, COUNT))
    AttitudeLoops(inertia).moments(goal, measured, rates, out)
    for column in range(COUNT):
        setpoint = AttitudeSetpoint(tuple(goal[:, column].tolist()), 0.5)
        control = AttitudeControl(Px4.data.loops, (0.02, 0.03, 0.05), setpoint, DT_S)
        single = control.moments_n_m(setpoint, tuple(measured[:, column].tolist()), *rates[:, column].tolist())
        np.testing.assert_allclose(out[:, column], single, rtol=1e-9, atol=1e-12)


def test_rotations_equal_those_of_frames() -> None:
    random = np.random.default_rng(3)
    quaternions, turns = random_quaternions(random, COUNT), random.standard_normal((3, COUNT)) * 0.02
    all_turned = product(quaternions, quaternion_of_turns(turns))
    euler = euler_rad(quaternions)
    back = quaternion_of_euler(*euler)
    for column in range(COUNT):
        quaternion = tuple(quaternions[:, column].tolist())
        single = turned(quaternion, small_turn(tuple(turns[:, column].tolist())))
        np.testing.assert_allclose(all_turned[:, column], single, atol=1e-12)
        np.testing.assert_allclose(euler[:, column], euler_from_quaternion(quaternion), atol=1e-9)
        np.testing.assert_allclose(back[:, column], quaternion_from_euler(*euler[:, column].tolist()), atol=1e-12)


def test_output_limits_equal_those_of_the_agent() -> None:
    """Some accelerations are far beyond the limits, and one vehicle has fallen over."""
    random = np.random.default_rng(4)
    scenarios = [platoon()] * 5
    columns = columns_of(scenarios)
    n = columns.count
    commands = AttitudeCommands(scenarios, columns, 0.02, np.full(n, 0.49))
    euler = np.stack([np.full(n, 0.05), np.full(n, -0.02), random.uniform(-3.0, 3.0, n)])
    commands.open_at(euler)
    limits = output_limits(Envelope())
    limiters = [OutputLimiter(limits) for _ in range(n)]
    for limiter, (roll, pitch, yaw) in zip(limiters, euler.T.tolist(), strict=True):
        limiter.open_at(0.0, AttitudeTarget(roll, pitch, yaw, 0.49 / (np.cos(roll) * np.cos(pitch))), 0.49)
    all_columns = slice(0, n)
    for tick in range(1, 40):
        wanted = random.standard_normal((3, n)) * 6.0
        rolls, pitches = random.uniform(-0.4, 0.4, (2, n))
        rolls[0] = 2.0 if tick > 5 else 0.0
        single = [limit_acceleration(u, limits.max_tilt_rad, 0.3, 1.6) for u in wanted.T.tolist()]
        before = commands.targets(all_columns)
        commands.limit(wanted, all_columns)
        np.testing.assert_allclose(wanted.T, single, atol=1e-9)
        admitted = commands.admitted(wanted, rolls, pitches, all_columns)
        for column in range(1, n):
            target = attitude_target(single[column], euler[2, column], rolls[column], pitches[column], 0.49)
            passed = limiters[column].admit(tick * 0.02, target, 0.49)
            assert passed is not None
            quaternion = quaternion_from_euler(passed.roll_rad, passed.pitch_rad, passed.yaw_rad)
            np.testing.assert_allclose(admitted[:, column], (*quaternion, passed.thrust_norm), atol=1e-9)
        assert np.array_equal(admitted[:, 0], before[:, 0]) == (tick > 5)  # fallen over


def output_limits(envelope: Envelope) -> OutputLimits:
    return OutputLimits(
        radians(envelope.max_tilt_deg),
        radians(envelope.max_tilt_rate_deg_s),
        envelope.min_thrust_ratio,
        envelope.max_thrust_ratio,
        envelope.max_thrust_rate_1_s,
        Fence(envelope.fence_min_enu_m, envelope.fence_max_enu_m),
    )


OBSERVERS = "fleet.law={{name: weighted, disturbance_bandwidth_1_s: {}, velocity_correction_1_s: {}}}"
TICKS = 60


def random_telemetry(random: np.random.Generator, count: int) -> FloatArray:
    """(ticks, 9, count): some vehicles move wildly, all have two jumps of position and velocity."""
    wildly = np.linspace(0.1, 1.0, count)
    telemetry = np.cumsum(random.standard_normal((TICKS, 9, count)) * wildly * 0.2, axis=0)
    telemetry[:, :3] *= 0.2
    telemetry[:, 6:9] *= 0.2
    telemetry[20:, :6] += 3.0
    telemetry[40:, :6] -= 2.0
    return telemetry


@pytest.mark.parametrize("bandwidth_1_s", [0.0, 4.0])
def test_disturbance_observers_estimate_as_those_of_the_agent(bandwidth_1_s: float) -> None:
    """Wind and errors up to all limits; beside formations whose observers are on."""
    random = np.random.default_rng(5)
    airframe, assumed = "stand_in.airframe.drag_n_per_m_s=0.3", "assumed.hover_thrust_norm=0.4"
    scenarios = [platoon(airframe, assumed, OBSERVERS.format(w, 0)) for w in (2.0, bandwidth_1_s)]
    columns = columns_of(scenarios)
    observers, every = DisturbanceObservers(scenarios, columns), slice(0, columns.count)
    hover = observers.hover_norm.tolist()
    assert sorted(set(hover)) == ([0.49] if bandwidth_1_s else [0.4, 0.49])
    singles = [
        DisturbanceObserver(h, 0.3, (2.0, bandwidth_1_s)[b]) for h, b in zip(hover, columns.formation, strict=True)
    ]
    sent = 0.49 * random.uniform(0.6, 1.4, (TICKS, columns.count))
    largest_m_s2 = 0.0
    for tick, telemetry in enumerate(random_telemetry(random, columns.count)):
        observers.update(tick, every, telemetry, sent[tick])
        for column, single in enumerate(singles):
            *_, vx, vy, vz, roll, pitch, yaw = telemetry[:, column].tolist()
            single.update(FlightSample(tick * 0.02, (vx, vy, vz), (roll, pitch, yaw), float(sent[tick, column])))
        np.testing.assert_allclose(observers.hover_norm, [s.hover_thrust_norm for s in singles], rtol=1e-9)
        disturbances = np.array([s.disturbance_enu_m_s2[:2] for s in singles]).T
        np.testing.assert_allclose(observers.disturbance_enu_m_s2, disturbances, atol=1e-9)
        largest_m_s2 = max(largest_m_s2, float(np.hypot(*disturbances).max()))
    assert largest_m_s2 > 1.0


def test_disturbance_observers_begin_with_the_mean_wind() -> None:
    """So a vehicle that hovers in it sees no error: neither of attitude and thrust nor of velocity."""
    wind = ("stand_in.wind.mean_enu_m_s=[4, -3, 2]", "stand_in.airframe={drag_n_per_m_s: 0.5, mass_kg: 2}")
    scenarios = [platoon(*wind, OBSERVERS.format(4, 0))]
    columns = columns_of(scenarios)
    observers, every = DisturbanceObservers(scenarios, columns), slice(0, columns.count)
    begin = observers.disturbance_enu_m_s2.copy(), observers.hover_norm.copy()
    assert begin[0][:, 0] == pytest.approx((1.0, -0.75), rel=0.06)
    still = np.zeros((3, columns.count))
    bodies = Bodies([s.stand_in.airframe for s in scenarios], columns.formation)
    wind_enu_m_s = np.repeat([[4.0], [-3.0], [2.0]], columns.count, axis=1)
    state = bodies.hovering(still, still, wind_enu_m_s)
    rate = bodies.rate_of_change(state, state[13:17], wind_enu_m_s, np.empty_like(state))
    np.testing.assert_allclose(rate[3:6], 0.0, atol=1e-12)
    telemetry = np.concatenate([still, still, euler_rad(state[6:10])])
    for tick in range(50):
        observers.update(tick, every, telemetry, 0.49 * state[13] / bodies.hover_n)
    np.testing.assert_allclose(observers.disturbance_enu_m_s2, begin[0], atol=1e-12)
    np.testing.assert_allclose(observers.hover_norm, begin[1], atol=1e-12)


def test_velocities_are_corrected_as_by_the_agent() -> None:
    """Two formations with it, up to its limits and over jumps of the position, and one without."""
    random = np.random.default_rng(6)
    bandwidths_1_s = (2.0, 8.0, 0.0)
    scenarios = [platoon(OBSERVERS.format(0, w)) for w in bandwidths_1_s]
    columns = columns_of(scenarios)
    corrections, every = VelocityCorrections(scenarios, columns), slice(0, columns.count)
    singles = [VelocityCorrection(w) if (w := bandwidths_1_s[b]) else None for b in columns.formation.tolist()]
    largest_m_s = 0.0
    for tick, telemetry in enumerate(random_telemetry(random, columns.count)):
        corrected = telemetry.copy()
        corrections.follow(tick, every, corrected)
        for column, single in enumerate(singles):
            x, y, z, *velocity = telemetry[:6, column].tolist()
            expected = single.follow(tick * 0.02, (x, y, z), tuple(velocity)) if single else velocity
            np.testing.assert_allclose(corrected[3:6, column], expected, atol=1e-9)
        np.testing.assert_array_equal(np.delete(corrected, [3, 4, 5], axis=0), np.delete(telemetry, [3, 4, 5], axis=0))
        largest_m_s = max(largest_m_s, float(np.linalg.norm(corrected - telemetry, axis=0).max()))
    assert largest_m_s == pytest.approx(0.6)


def test_columns_are_sorted_by_phase_and_map_back_to_vehicles() -> None:
    columns = columns_of([platoon(f"stand_in.seed={seed}") for seed in range(6)])
    assert (np.diff(columns.phase_steps) >= 0).all()
    for phase, group in enumerate(columns.groups):
        assert (columns.phase_steps[group] == phase).all()
    assert sum(group.stop - group.start for group in columns.groups) == 24
    by_vehicle = np.arange(24.0 * 3).reshape(6, 4, 3)
    np.testing.assert_array_equal(columns.by_vehicle(columns.in_columns(by_vehicle)), by_vehicle)
    np.testing.assert_array_equal(columns.formation, columns.order // 4)
