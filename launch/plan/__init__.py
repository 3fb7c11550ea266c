"""From a checked session to what each process receives: everything is settled before a process starts.

Read ``prepare`` first (the certificate), then ``topology`` (nodes and links), ``access`` (rights), ``reach`` and
``keys`` (addresses and keys), and ``bundles`` (one for each process).
"""
