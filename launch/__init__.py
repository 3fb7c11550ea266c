"""Session files, the supervisor, the command line."""
