"""`make soak`: a formation of real processes for an hour, with memory, files, threads and tick timing over time."""
