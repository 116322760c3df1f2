"""What the viewer sees: cameras, the eye, the fovea, fusion and blending. No renderer in here."""

from compose.base.startup import let_waiting_threads_sleep, point_drjit_to_llvm

# These must come before anything imports drjit, which loads LLVM at once, or torch, which loads OpenMP.
LLVM = point_drjit_to_llvm()
let_waiting_threads_sleep()
