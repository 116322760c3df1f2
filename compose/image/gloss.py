"""Classes of gloss: how much of what a surface shows depends on the direction it is seen from."""

# Plain integers, in ascending order of gloss: kernels of Dr.Jit and arrays of numpy hold them alike.
DIFFUSE, GLOSSY, SPECULAR = 0, 1, 2
