"""What every process of a session stands on: its bundle, its clock's waits, its log, its rights, arithmetic of a tick.

Read ``bundle`` first (what one process is handed) with what it states: ``driver_statement``, ``inertia``,
``allowance``, ``energy_budget``, ``site_bounds``. Then ``timeouts``, ``lifetime``, ``realtime`` and ``log``.
"""
