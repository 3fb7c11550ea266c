"""What crosses a process border: messages, codec, channels, clock, handshake, transports. See SPEC.md.

Read ``messages`` and ``channels`` first (what is exchanged), then ``codec`` and ``gate`` (what is admitted), and
``handshake`` with ``keys`` (who takes part); ``transport/`` moves the bytes.
"""
