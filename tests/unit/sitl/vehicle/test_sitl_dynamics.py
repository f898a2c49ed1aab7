"""The rigid body against results computed by hand."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, pi, sin, sqrt

import pytest

from companion.geometry.frames import euler_from_quaternion, quaternion_from_euler
from companion.types.vectors import GRAVITY_M_S2, ZERO3
from sitl.vehicle.dynamics import (
    POSITION,
    RATES,
    THRUST,
    VELOCITY,
    Body,
    State,
    at_rest,
    derivative,
    euler,
    normalised,
    rk4,
)

BODY = Body(mass_kg=1.2, inertia_kg_m2=(0.02, 0.03, 0.04), drag_n_per_m_s=0.0, motor_lag_s=0.05)
LEVEL = quaternion_from_euler(0.0, 0.0, 0.0)
HOVER_N = BODY.mass_kg * GRAVITY_M_S2
Integrator = Callable[..., State]


def run(state: State, rate: Callable[[State], State], seconds: float, dt_s: float, step: Integrator = rk4) -> State:
    for _ in range(round(seconds / dt_s)):
        state = normalised(step(rate, state, dt_s))
    return state


def with_thrust(state: State, newton: float) -> State:
    return (*state[:THRUST], newton, *state[THRUST + 1 :])


@pytest.mark.parametrize("step", [euler, rk4])
def test_the_position_is_constant_in_hover(step: Integrator) -> None:
    state = with_thrust(at_rest((1.0, 2.0, 3.0), LEVEL), HOVER_N)
    state = run(state, derivative(BODY, HOVER_N, ZERO3, ZERO3), 5.0, 0.004, step)
    assert state[POSITION] == pytest.approx((1.0, 2.0, 3.0), abs=1e-9)


@pytest.mark.parametrize("step", [euler, rk4])
def test_free_fall_has_the_acceleration_of_gravity(step: Integrator) -> None:
    state = run(at_rest((0.0, 0.0, 100.0), LEVEL), derivative(BODY, 0.0, ZERO3, ZERO3), 2.0, 0.004, step)
    assert state[2] == pytest.approx(100.0 - 0.5 * GRAVITY_M_S2 * 4.0, abs=1e-6)
    assert state[5] == pytest.approx(-2.0 * GRAVITY_M_S2)


def test_the_velocity_approaches_the_terminal_velocity() -> None:
    dragged = Body(1.2, (0.02, 0.03, 0.04), 0.6, 0.05)
    state = run(at_rest((0.0, 0.0, 500.0), LEVEL), derivative(dragged, 0.0, ZERO3, ZERO3), 20.0, 0.004)
    assert state[5] == pytest.approx(-dragged.mass_kg * GRAVITY_M_S2 / dragged.drag_n_per_m_s, rel=1e-3)


def test_drag_is_relative_to_the_air() -> None:
    dragged = Body(1.0, (0.02, 0.03, 0.04), 0.5, 0.05)
    state = with_thrust(at_rest(ZERO3, LEVEL), GRAVITY_M_S2)
    state = run(state, derivative(dragged, GRAVITY_M_S2, ZERO3, (3.0, -2.0, 0.0)), 2.0, 0.004)
    share = 1.0 - exp(-0.5 * 2.0)
    assert state[VELOCITY] == pytest.approx((3.0 * share, -2.0 * share, 0.0), abs=1e-6)


def test_the_direction_of_thrust_is_that_of_equation_2() -> None:
    roll, pitch, yaw = 0.3, -0.2, 0.7
    state = with_thrust(at_rest(ZERO3, quaternion_from_euler(roll, pitch, yaw)), 5.0)
    acceleration = derivative(BODY, 5.0, ZERO3, ZERO3)(state)[VELOCITY]
    per_mass = 5.0 / BODY.mass_kg
    assert acceleration == pytest.approx(
        (
            (sin(yaw) * sin(roll) + cos(yaw) * cos(roll) * sin(pitch)) * per_mass,
            (cos(roll) * sin(yaw) * sin(pitch) - cos(yaw) * sin(roll)) * per_mass,
            cos(pitch) * cos(roll) * per_mass - GRAVITY_M_S2,
        )
    )


def test_thrust_follows_with_the_motor_lag() -> None:
    state = run(at_rest(ZERO3, LEVEL), derivative(BODY, 10.0, (1.0, 0.0, 0.0), ZERO3), 0.05, 0.001)
    assert state[THRUST] == pytest.approx(10.0 * (1.0 - exp(-1.0)), rel=1e-6)
    assert state[THRUST + 1] == pytest.approx(1.0 - exp(-1.0), rel=1e-6)


def test_energy_and_angular_momentum_are_constant_without_moments() -> None:
    """Euler's equations (eq. 1, third line) without a moment."""
    state = (*at_rest(ZERO3, LEVEL)[:10], 3.0, -2.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    after = run(state, derivative(BODY, 0.0, ZERO3, ZERO3), 5.0, 0.004)

    def invariants(of: State) -> tuple[float, float]:
        rates = of[RATES]
        energy = sum(j * w * w for j, w in zip(BODY.inertia_kg_m2, rates, strict=True))
        momentum = sqrt(sum((j * w) ** 2 for j, w in zip(BODY.inertia_kg_m2, rates, strict=True)))
        return energy, momentum

    assert invariants(after) == pytest.approx(invariants(state), rel=1e-7)
    assert after[RATES] != pytest.approx(state[RATES], abs=0.1)


def test_turning_about_one_axis() -> None:
    state = (*at_rest(ZERO3, LEVEL)[:10], 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0)
    after = run(state, derivative(BODY, 0.0, ZERO3, ZERO3), 2.0, 0.004)
    w, x, y, z = after[6:10]
    assert euler_from_quaternion((w, x, y, z)) == pytest.approx((0.0, 0.0, 1.0), abs=1e-9)


@pytest.mark.parametrize(("step", "order"), [(euler, 1), (rk4, 4)])
def test_the_error_of_an_integrator_falls_with_its_order(step: Integrator, order: int) -> None:
    """With half the step the error falls by 2^order."""
    body = Body(1.2, (0.02, 0.03, 0.04), 0.8, 0.2)
    start = (0.0, 0.0, 0.0, 4.0, 1.0, 0.0, *LEVEL, 1.0, 2.0, -1.0, 3.0, 0.0, 0.0, 0.0)
    rate = derivative(body, 14.0, (0.02, -0.01, 0.02), (1.0, 0.0, 0.0))

    def after(steps: int) -> State:
        state: State = start
        for _ in range(steps):
            state = step(rate, state, 0.8 / steps)
        return state

    exact = after(4000) if step is rk4 else run_exactly(rate, start)
    coarse, fine = (max(abs(a - b) for a, b in zip(after(n), exact, strict=True)) for n in (20, 40))
    assert coarse / fine == pytest.approx(2.0**order, rel=0.15)


def run_exactly(rate: Callable[[State], State], state: State) -> State:
    for _ in range(4000):
        state = rk4(rate, state, 0.8 / 4000)
    return state


def test_a_full_turn_of_yaw_ends_at_the_first_attitude() -> None:
    state = (*at_rest(ZERO3, LEVEL)[:10], 0.0, 0.0, pi, 0.0, 0.0, 0.0, 0.0)
    after = run(state, derivative(BODY, 0.0, ZERO3, ZERO3), 2.0, 0.004)
    assert abs(after[6]) == pytest.approx(1.0, abs=1e-6)
