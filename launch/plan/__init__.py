"""From a checked session to what each process receives: everything is settled before a process starts.

Read ``loop`` first (the session in the types of ``design``), then ``certificates``, ``sites`` and ``prepare`` (which
coupling a run has, and what proves it), ``topology`` (nodes and links), ``access`` (rights), ``reach`` and ``keys``
(addresses and keys), and ``bundles`` (one for each process).
"""
