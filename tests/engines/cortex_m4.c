/* Start of a Cortex-M4 program under semihosting: floating-point unit, memory, files of the host, main. */
#include <stdint.h>
#include <stdlib.h>

extern uint32_t data_begin, data_end, data_load, bss_begin, bss_end, stack_top;
extern void initialise_monitor_handles(void);
int main(void);

void Reset(void) {
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20; /* coprocessors 10 and 11: the floating-point unit */
    uint32_t *from = &data_load;
    for (uint32_t *to = &data_begin; to < &data_end;) *to++ = *from++;
    for (uint32_t *to = &bss_begin; to < &bss_end;) *to++ = 0u;
    initialise_monitor_handles();
    exit(main());
}

void _init(void) {}
void _fini(void) {}

static void fault(void) { exit(3); }
__attribute__((section(".vectors"), used)) static const void *const vectors[] = {&stack_top, Reset, fault, fault, fault};
