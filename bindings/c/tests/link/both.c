/* Steps a model beside another static library of Rust: both model.rfm */
#include "scene.h"

uint32_t other_sum(uint32_t count);

int main(int count, char **words) {
    float height;
    if (count < 2 || other_sum(10) != 56) return fprintf(stderr, "the other library is wrong\n"), 1;
    if (fall(words[1], &height)) return 1;
    printf("both: %.4f m\n", (double)height);
    return other_sum(3) != 7;
}
