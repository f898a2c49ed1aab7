"""The only room on board with asyncio, sockets, Zenoh and clocks."""
