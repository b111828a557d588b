/* A stand-in for what the sample takes of Zephyr's kernel. */
#ifndef ZEPHYR_KERNEL_H
#define ZEPHYR_KERNEL_H

void k_panic(void);

#endif
