"""The versioned messages that vehicles and ground exchange over Zenoh."""
