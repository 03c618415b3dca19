"""The only sockets, clock, threads and processes of the companion."""
