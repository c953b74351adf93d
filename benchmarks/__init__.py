"""The comparison of ``make bench``, and separate studies.

``python -m benchmarks`` runs the ``questions``, each case in a separate process in which polywigner
and the ``peers`` take turns, and writes a table, JSON and figures to ``benchmarks/results``. The
other scripts in this folder are studies: run one with ``python``.
"""
