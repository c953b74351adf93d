"""Independent references: slow, exact values of the transforms.

This folder imports no kernel of polywigner and shares no formula with the kernels:

- :mod:`oracles.exact` cuts the slices of the autocorrelation into trapezoids in rational
  arithmetic and transforms them by divided differences of exp with 50 digits or more;
- :mod:`oracles.short_program` runs the program of docs/theory;
- :mod:`oracles.positions` has positions and lags at which edges coincide; :mod:`oracles.drawn`
  has random apertures for hypothesis.
"""
