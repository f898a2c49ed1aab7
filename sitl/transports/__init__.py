"""Age of the peers' states over each transport while the network loses packets, measured with the agent's own links."""
