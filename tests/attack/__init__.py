"""A standing attack on certificates: what `prove` accepts is held against an oracle that shares no code with it."""
