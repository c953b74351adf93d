"""Independent oracles: slow, exact routes to the values that polywigner computes fast.

Nothing here imports polywigner's kernels, and no formula is shared with them:

- :mod:`oracles.exact` cuts the slices of the autocorrelation into trapezoids in rational
  arithmetic and transforms them by divided differences of exp at 50 digits or more;
- :mod:`oracles.short_program` runs the program that opens docs/theory;
- :mod:`oracles.shapes` and :mod:`oracles.positions` are the apertures and the awkward positions
  on which edges coincide; :mod:`oracles.drawn` draws random apertures for hypothesis.
"""
