"""Selection and installation of the LLVM library that compiles the kernels.

No module of this subpackage imports Dr.Jit before an LLVM library has been selected.
"""
