"""Reference trajectories (RFT), their changes and the formation heading."""
