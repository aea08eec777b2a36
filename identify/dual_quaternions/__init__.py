"""Dual quaternions: algebra, kinematics and elasticity of serial robots, a road of its own beside the springs.

A dual quaternion ``r + eps d`` (``eps^2 = 0``) is a float64 array (..., 8): w, x, y, z of the real part, then those of
the dual part. A placement with rotation r (unit quaternion) and translation p, m, is ``r + eps p r / 2``;
``q`` and ``-q`` are the same placement. Placements are multiplied as their homogeneous matrices are.

Source: Li, Zhang, Fu, Wang, "Joint Stiffness Identification and Deformation Compensation of Serial Robots Based on
Dual Quaternion Algebra", MDPI, 25 December 2018; equation numbers in this package are theirs. What was read where
the printed equations do not fit together stands in docs/theory.md.
"""
