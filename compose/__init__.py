"""What the viewer sees: cameras, the eye's geometry, the blend of two pictures. No renderer in here."""

from compose.base.llvm import point_drjit_to_llvm

# Before anything imports drjit, which loads LLVM at once.
LLVM = point_drjit_to_llvm()
