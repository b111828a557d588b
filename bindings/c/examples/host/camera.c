/* What small.c leaves to its reader: two cubes of 0.4 m that fall, 1/24 s from call to call. */
void camera(float frame[2][64][3]);

void camera(float frame[2][64][3]) {
    static float fallen;
    for (int unit = 0; unit < 2; unit++)
        for (int i = 0; i < 64; i++) {
            frame[unit][i][0] = 0.4f / 3.0f * (float)(i % 4) + 0.6f * (float)unit;
            frame[unit][i][1] = 0.4f / 3.0f * (float)(i / 4 % 4);
            frame[unit][i][2] = 0.4f / 3.0f * (float)(i / 16) + 1.0f - fallen;
        }
    fallen += 0.02f;
}
