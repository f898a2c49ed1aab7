"""Linear analysis of a formation: spectra, margins, predictions. Flight code never imports it."""
