"""How a recording is written: chunks, files, their folder, and a thread for the disk."""
