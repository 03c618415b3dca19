"""Bytes and messages: what MAVLink needs between sockets and values.  No sockets, no clock."""
