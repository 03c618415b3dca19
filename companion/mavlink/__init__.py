"""How to say it: bytes and messages, no sockets."""
