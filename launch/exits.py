"""The exit codes of the command line, which other programs rely on."""

EXIT_OK = 0
EXIT_FAILED = 1  # a process failed, or a file could not be written
EXIT_BAD_INPUT = 2
EXIT_NOT_CERTIFIED = 3
EXIT_INTERRUPTED = 130  # Ctrl-C; other signals likewise, 128 + their number
