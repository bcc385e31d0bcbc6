/* stdio.h - for WebAssembly: splat.c prints from main only, which is left out (SPLAT_NO_MAIN). */
