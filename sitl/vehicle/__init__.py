"""The simulated quadrotor: body, motors, sensors, estimator and its own flight control."""
