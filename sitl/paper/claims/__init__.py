"""Verdicts on the claims about the flown experiments: figures 4 to 10 and section 5."""
