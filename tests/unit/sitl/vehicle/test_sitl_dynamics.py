"""The rigid body against results computed by hand, and against its equations integrated by Runge-Kutta."""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt

import pytest

from companion.geometry.frames import euler_from_quaternion, quaternion_from_euler
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3
from sitl.vehicle.dynamics import POSITION, RATES, THRUST, VELOCITY, Body, State, at_rest
from stand_ins import Equations

MASS_KG, INERTIA_KG_M2, LAG_S, DT_S = 1.2, (0.02, 0.03, 0.04), 0.05, 0.004
HOVER_N = MASS_KG * GRAVITY_M_S2
LEVEL = quaternion_from_euler(0.0, 0.0, 0.0)


def body(drag_n_per_m_s: float = 0.0, dt_s: float = DT_S) -> Body:
    return Body(MASS_KG, INERTIA_KG_M2, drag_n_per_m_s, LAG_S, dt_s)


def run(
    of: Body,
    state: State,
    steps: int,
    thrust_n: float = 0.0,
    moments_n_m: Vector3 = ZERO3,
    wind_enu_m_s: Vector3 = ZERO3,
) -> State:
    for _ in range(steps):
        state = of.step(state, thrust_n, moments_n_m, wind_enu_m_s)
    return state


def with_thrust(state: State, newton: float) -> State:
    return (*state[:THRUST], newton, *state[THRUST + 1 :])


def turning(rates_rad_s: Vector3) -> State:
    return (*at_rest(ZERO3, LEVEL)[:10], *rates_rad_s, 0.0, 0.0, 0.0, 0.0)


def test_the_position_is_constant_in_hover() -> None:
    state = run(body(), with_thrust(at_rest((1.0, 2.0, 3.0), LEVEL), HOVER_N), 1250, HOVER_N)
    assert state[POSITION] == pytest.approx((1.0, 2.0, 3.0), abs=1e-9)


def test_free_fall_has_the_acceleration_of_gravity() -> None:
    state = run(body(), at_rest((0.0, 0.0, 100.0), LEVEL), 500)
    assert state[2] == pytest.approx(100.0 - 0.5 * GRAVITY_M_S2 * 4.0, abs=1e-6)
    assert state[5] == pytest.approx(-2.0 * GRAVITY_M_S2)


def test_the_velocity_approaches_the_terminal_velocity() -> None:
    state = run(body(drag_n_per_m_s=0.6), at_rest((0.0, 0.0, 500.0), LEVEL), 5000)
    assert state[5] == pytest.approx(-MASS_KG * GRAVITY_M_S2 / 0.6, rel=1e-3)


def test_drag_is_relative_to_the_air() -> None:
    state = with_thrust(at_rest(ZERO3, LEVEL), HOVER_N)
    state = run(body(drag_n_per_m_s=0.6), state, 500, HOVER_N, wind_enu_m_s=(3.0, -2.0, 0.0))
    share = 1.0 - exp(-0.6 / MASS_KG * 2.0)
    assert state[VELOCITY] == pytest.approx((3.0 * share, -2.0 * share, 0.0), abs=2e-3)


def test_the_direction_of_thrust_is_that_of_equation_2() -> None:
    roll, pitch, yaw = 0.3, -0.2, 0.7
    state = with_thrust(at_rest(ZERO3, quaternion_from_euler(roll, pitch, yaw)), 5.0)
    velocity, per_mass = run(body(), state, 1, 5.0)[VELOCITY], 5.0 / MASS_KG
    assert [v / DT_S for v in velocity] == pytest.approx(
        (
            (sin(yaw) * sin(roll) + cos(yaw) * cos(roll) * sin(pitch)) * per_mass,
            (cos(roll) * sin(yaw) * sin(pitch) - cos(yaw) * sin(roll)) * per_mass,
            cos(pitch) * cos(roll) * per_mass - GRAVITY_M_S2,
        )
    )


def test_thrust_and_moments_follow_with_the_motor_lag() -> None:
    state = run(body(dt_s=1e-5), at_rest(ZERO3, LEVEL), 5000, 10.0, (1.0, 0.0, 0.0))
    assert state[THRUST] == pytest.approx(10.0 * (1.0 - exp(-1.0)), rel=2e-4)
    assert state[THRUST + 1] == pytest.approx(1.0 - exp(-1.0), rel=2e-4)


def test_without_motor_lag_thrust_and_moments_act_at_once() -> None:
    instant = Body(MASS_KG, INERTIA_KG_M2, 0.0, 0.0, DT_S)
    state = run(instant, at_rest(ZERO3, LEVEL), 1, 2.0 * HOVER_N, (0.2, 0.0, 0.0))
    assert state[5] == pytest.approx(GRAVITY_M_S2 * DT_S)
    assert state[RATES] == pytest.approx((0.2 / 0.02 * DT_S, 0.0, 0.0))
    assert state[THRUST:] == (2.0 * HOVER_N, 0.2, 0.0, 0.0)


def test_energy_and_angular_momentum_are_constant_without_moments() -> None:
    """Euler's equations (eq. 1, third line) without a moment."""
    state = turning((3.0, -2.0, 1.0))
    after = run(body(dt_s=1e-5), state, 50_000)

    def invariants(of: State) -> tuple[float, float]:
        rates = of[RATES]
        energy = sum(j * w * w for j, w in zip(INERTIA_KG_M2, rates, strict=True))
        momentum = sqrt(sum((j * w) ** 2 for j, w in zip(INERTIA_KG_M2, rates, strict=True)))
        return energy, momentum

    assert invariants(after) == pytest.approx(invariants(state), rel=1e-5)
    assert after[RATES] != pytest.approx(state[RATES], abs=0.1)


def test_turning_about_one_axis() -> None:
    w, x, y, z = run(body(), turning((0.0, 0.0, 0.5)), 500)[6:10]
    assert euler_from_quaternion((w, x, y, z)) == pytest.approx((0.0, 0.0, 1.0), abs=1e-6)


def test_a_full_turn_of_yaw_ends_at_the_first_attitude() -> None:
    assert abs(run(body(), turning((0.0, 0.0, pi)), 500)[6]) == pytest.approx(1.0, abs=1e-6)


def test_the_error_against_runge_kutta_falls_with_the_step() -> None:
    """With half the step the error is half: the body integrates the same equations, in first order."""
    start = (0.0, 0.0, 0.0, 4.0, 1.0, 0.0, *LEVEL, 1.0, 2.0, -1.0, 3.0, 0.0, 0.0, 0.0)
    moments, wind = (0.02, -0.01, 0.02), (1.0, 0.0, 0.0)
    exact = Equations(1.2, INERTIA_KG_M2, 0.8, 0.2, 14.0, moments, wind).after(start, 0.8 / 4000, 4000)

    def error(steps: int) -> float:
        after = run(Body(1.2, INERTIA_KG_M2, 0.8, 0.2, 0.8 / steps), start, steps, 14.0, moments, wind)
        return max(abs(a - b) for a, b in zip(after, exact, strict=True))

    assert error(20) / error(40) == pytest.approx(2.0, rel=0.15)
    assert error(4000) < 0.02 * error(40)


def test_runge_kutta_has_fourth_order() -> None:
    """The reference of the other tests."""
    start = (0.0, 0.0, 0.0, 4.0, 1.0, 0.0, *LEVEL, 1.0, 2.0, -1.0, 3.0, 0.0, 0.0, 0.0)
    equations = Equations(1.2, INERTIA_KG_M2, 0.8, 0.2, 14.0, (0.02, -0.01, 0.02), (1.0, 0.0, 0.0))
    exact = equations.after(start, 0.8 / 4000, 4000)
    coarse, fine = (
        max(abs(a - b) for a, b in zip(equations.after(start, 0.8 / n, n), exact, strict=True)) for n in (20, 40)
    )
    assert coarse / fine == pytest.approx(16.0, rel=0.3)
