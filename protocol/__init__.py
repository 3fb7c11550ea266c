"""The protocol between processes: messages, codec, channels, clock, handshake, keys, transports. See SPEC.md.

Read ``messages`` and ``channels`` first (what is exchanged), then ``codec`` and ``gate`` (what is admitted), and
``handshake`` with ``keys`` (which processes take part). ``transport/`` moves the bytes.
"""
