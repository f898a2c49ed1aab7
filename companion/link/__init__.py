"""Links of the agent: asyncio, sockets, serial lines, Zenoh, clocks. The only package on board that uses them."""
