"""Peers -> neighbours, PrC, weights and the formation law."""
