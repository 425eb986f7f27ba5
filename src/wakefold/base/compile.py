"""How kernels are compiled: on first use, kept on disk, without the interpreter lock.

Wrappers nobody calls cost a fifth of the compile time, so they are left out: those for C callers, and for ``inner``
functions, which only other kernels call, those for Python too. (Python calling one would crash; a test looks for it.)
"""

from functools import partial
from typing import Any

from numba import njit

_njit: Any = njit  # numba's type hints lack the wrappers' options
_compiled = partial(_njit, cache=True, nogil=True, no_cfunc_wrapper=True)

kernel = _compiled()
inner = _compiled(no_cpython_wrapper=True)

# Division by zero gives infinity, as numpy has it, and no error: so loops are free of branches and can be vectorised.
wide_kernel = _compiled(error_model="numpy")
wide_inner = _compiled(error_model="numpy", no_cpython_wrapper=True)

# For numbers without NaN: knowing that lets LLVM vectorise a maximum.
_ordered = {"nnan", "nsz"}
ordered_kernel = _compiled(fastmath=_ordered)
ordered_inner = _compiled(fastmath=_ordered, no_cpython_wrapper=True)
