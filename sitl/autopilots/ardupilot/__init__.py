"""The stand-in that behaves like ArduCopter 4.7."""
