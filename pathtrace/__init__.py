"""From scene to radiance: Mitsuba 3 traces any list of film positions. Knows nothing of Gaussians."""

import compose  # noqa: F401  (first: it points Dr.Jit to a usable LLVM)
