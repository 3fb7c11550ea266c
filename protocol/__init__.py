"""What crosses a process border: messages, codec, channels, clock, handshake, transports. See SPEC.md."""
