"""Looking at sessions: which run (``sessions``), their state and values (``tables``, ``topics``), pictures, a page.

Read ``sessions`` first, then ``tables`` (list and top) and ``topics`` (echo and rates). ``display`` is the table of a
run in its own terminal, ``attached`` records a running session, ``plots`` draws recordings, ``graph/`` the nodes and
their links, ``page/`` all of it in a browser.
"""
