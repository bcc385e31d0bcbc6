/* frame_flip.h - from our frame (x right, y down, z forward: COLMAP's, and the standard PLY's) to that of SPZ and glTF (x right, y up,
 * z back), and the same way back.
 *
 * It is half a turn about x. Nothing but signs changes, so no number loses a digit: y and z of a place, y and z of a quaternion
 * (of r q r^-1, with r that half turn), and of the harmonics those that are odd in y and z together.
 */
#ifndef OXL_FRAME_FLIP_H
#define OXL_FRAME_FLIP_H

/* (coefficients past the first, of degree 3) by the basis of Kerbl 2023: degree 1 y z x; 2 xy yz zz xz xx-yy; 3 in their order. */
static const signed char frame_flip_sh[15] = {-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1};

#endif
