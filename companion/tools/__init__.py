"""Commands of one vehicle or file: analysis, doctor, flight logs; each with its report."""
