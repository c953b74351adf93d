"""The LLVM library and the GPU: found, tried out in a process of their own, installed.

Nothing here imports Dr.Jit before a library has been chosen for it.
"""
