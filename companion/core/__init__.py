"""Pure control core: no clocks, sockets, asyncio, randomness or files. Time is an argument."""
