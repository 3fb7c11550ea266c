"""A standing attack on certificates: an oracle that shares no code with `prove` checks what `prove` accepts."""
