"""Study beyond the paper: formations of 4 to 100 vehicles under every setting of the law, with figures and verdicts."""
