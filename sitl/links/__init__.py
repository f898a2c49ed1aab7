"""What carries messages: sockets, the direct link of virtual time, the networks between agents, and the ports of a fleet."""
