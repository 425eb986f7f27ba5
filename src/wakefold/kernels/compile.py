"""How kernels are compiled: on first use, kept on disk, without the interpreter lock.

Wrappers nobody calls cost a fifth of the compile time, so they are left out: those for C callers, and for ``inner``
functions, which only other kernels call, those for Python too. (Python calling one would crash; a test looks for it.)
"""

from numba import njit

kernel = njit(cache=True, nogil=True, no_cfunc_wrapper=True)
inner = njit(cache=True, nogil=True, no_cfunc_wrapper=True, no_cpython_wrapper=True)
