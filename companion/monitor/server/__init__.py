"""The HTTP server of the live page: its page, the interface for programs, and who may use them."""
