/* setjmp.h - for WebAssembly, which cannot jump out of a function: an image for which memory does not suffice ends the worker. */
#ifndef PLAYGROUND_SETJMP_H
#define PLAYGROUND_SETJMP_H
typedef int jmp_buf[1];
#define setjmp(at) ((void)(at), 0)
#define longjmp(at, value) ((void)(at), (void)(value), __builtin_trap())
#endif
