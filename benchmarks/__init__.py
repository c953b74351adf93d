"""The comparison behind ``make bench``, and studies of one thing each.

``python -m benchmarks`` asks the ``questions`` one after the other, each case in a process of its
own in which we and the ``peers`` take turns, and writes a table, JSON and figures into
``benchmarks/results``. The other scripts in this folder are studies: run one with ``python``.
"""
