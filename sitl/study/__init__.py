"""What lies past the paper: formations of 4 to 100 vehicles under every setting of the law, and what each brings about."""
