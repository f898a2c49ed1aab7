"""The whole fleet read-only in QGroundControl: `companion monitor --mavlink udpout:HOST:PORT`."""
