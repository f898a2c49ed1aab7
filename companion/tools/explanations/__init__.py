"""Symptom, cause and remedy of every code: `companion explain` and docs/troubleshooting.md."""
