"""The figures of the report, drawn from the flights."""
