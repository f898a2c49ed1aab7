"""Mutation tests of the code that decides what is sent: whether the tests of the core notice a changed line or constant."""
