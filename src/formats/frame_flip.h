/* frame_flip.h - converts between our frame (x right, y down, z forward: COLMAP's and the standard PLY's) and
 * that of SPZ and glTF (x right, y up, z back).
 *
 * A rotation by 180 degrees about x, its own inverse. Only signs change, so it is exact: y and z of
 * positions, y and z of quaternions (r q r^-1, with r that rotation), and spherical harmonics that are odd in
 * y and z together.
 */
#ifndef OXL_FRAME_FLIP_H
#define OXL_FRAME_FLIP_H

/* Lists the signs of the coefficients of degrees 1 to 3 (15), by the basis of Kerbl 2023: degree 1 y z x;
 * 2 xy yz zz xz xx-yy; 3 in their order. */
static const signed char frame_flip_sh[15] = {-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

#endif
