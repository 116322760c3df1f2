"""What the viewer sees: cameras, the eye, the fovea, fusion and blending. No renderer in here."""

from compose.base.llvm import point_drjit_to_llvm

# This must come before anything imports drjit, which loads LLVM at once.
LLVM = point_drjit_to_llvm()
