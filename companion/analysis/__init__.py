"""One linear model of a formation: responses, spectra, margins and predictions, and whether the law keeps a reference's pace.

The agent checks commanded references by `pace.py` and what it imports, which do without numpy; the core never imports this.
"""
