/* Steps a model on a thread with so much stack, and says how much of it was used: stack KIB model.rfm ... */
#define _GNU_SOURCE
#include "scene.h"
#include <pthread.h>
#include <string.h>
#include <sys/mman.h>

typedef struct {
    rooms of;
    float height;
    rf_status status;
} task;

static void *work(void *argument) {
    task *own = argument;
    own->status = run(own->of.model, own->of.bytes, own->of.memory, own->of.size, &own->height);
    return NULL;
}

int main(int count, char **words) {
    if (count < 3) return 2;
    const size_t size = (size_t)atoi(words[1]) * 1024, page = 4096;
    for (int i = 2; i < count; i++) {
        task own = {0};
        if (make_room(words[i], &own.of)) return 1;
        /* Below it is a page that may not be touched. */
        uint8_t *memory = mmap(NULL, size + page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
        if (memory == MAP_FAILED || mprotect(memory, page, PROT_NONE)) return 1;
        memset(memory + page, 0xa5, size);
        pthread_attr_t attributes;
        pthread_t thread;
        pthread_attr_init(&attributes);
        if (pthread_attr_setstack(&attributes, memory + page, size)) return fprintf(stderr, "no such stack\n"), 1;
        if (pthread_create(&thread, &attributes, work, &own) || pthread_join(thread, NULL)) return 1;
        if (own.status) return fprintf(stderr, "%s\n", rf_error_string(own.status)), 1;
        size_t untouched = 0;
        while (untouched < size && memory[page + untouched] == 0xa5) untouched++;
        printf("stack: %s, %.4f m, %zu of %zu bytes\n", words[i], (double)own.height, size - untouched, size);
    }
    return 0;
}
