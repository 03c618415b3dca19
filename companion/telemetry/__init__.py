"""What happened: the run folder that every flight leaves."""
