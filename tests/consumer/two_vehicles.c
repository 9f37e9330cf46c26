/* Two vehicles of different sizes in one image. */
int lpvg_g80_task(void);
int OTHER_TASK(void);

int main(void) { return lpvg_g80_task() + OTHER_TASK(); }
