"""What the viewer sees: cameras, the eye, the fovea, fusion and blending. No renderer in here."""

from compose.base.llvm import point_drjit_to_llvm
from compose.base.threads import let_waiting_threads_sleep

# These must come before anything imports drjit, which loads LLVM at once, or torch, which loads OpenMP.
LLVM = point_drjit_to_llvm()
let_waiting_threads_sleep()
