"""`make hostile`: decoders and whole agents under seeded streams of damaged, wrong and forged messages."""
