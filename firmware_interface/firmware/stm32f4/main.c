/* The firmware on an STM32F405: clocks, serial line, sensors, main loop, and the alarm's interrupt,
 * which is the only place that drives valves. */
#include <stdbool.h>

#include "abt_board_config.h"
#include "abt_firmware.h"
#include "board.h"
#include "timer.h"

/* Looks at a bit that may never come: 10 ms at 16 MHz, where a crystal takes 2 ms. Three waits in
 * vain must fit into the independent watchdog's shortest 34 ms. */
#define PATIENCE 16000u

#define RECEIVE_MAX 1024u /* powers of two */
#define SEND_MAX 512u

typedef struct {
    uint32_t timer_hz;
    uint32_t usart_hz;
} clocks;

static abt_firmware firmware;
static volatile uint32_t runs; /* of the alarm's interrupt */

/* One side writes `in`, the other `out`; both only rise. */
static struct {
    volatile uint32_t in, out;
    volatile uint32_t stamp_us; /* when the newest byte came in */
    uint8_t bytes[RECEIVE_MAX];
} received;

static struct {
    volatile uint32_t in, out;
    uint8_t bytes[SEND_MAX];
} to_send;

void USART1_IRQHandler(void);

/* ---- Clocks ------------------------------------------------------------------------------- */

static bool comes(volatile uint32_t *where, uint32_t mask, uint32_t value)
{
    for (uint32_t i = 0; i < PATIENCE; i++) {
        if ((*where & mask) == value) {
            return true;
        }
    }
    return false;
}

/* 168 MHz from the crystal, or from the internal 16 MHz if it does not start. */
static clocks start_clocks(void)
{
    RCC_CR |= RCC_CR_HSEON;
    const bool crystal = comes(&RCC_CR, RCC_CR_HSERDY, RCC_CR_HSERDY);
    const uint32_t input_mhz = crystal ? CRYSTAL_MHZ : 16u;
    /* 1 MHz * 336 / 2; / 7 is 48 MHz for the random generator */
    RCC_PLLCFGR = input_mhz | (336u << 6) | (7u << 24) | (crystal ? RCC_PLLCFGR_SRC_HSE : 0u);
    RCC_CR |= RCC_CR_PLLON | (crystal ? RCC_CR_CSSON : 0u);
    if (!comes(&RCC_CR, RCC_CR_PLLRDY, RCC_CR_PLLRDY)) {
        return (clocks){16000000u, 16000000u}; /* on the internal oscillator since reset */
    }
    FLASH_ACR = FLASH_ACR_5_WAITS_CACHES;
    RCC_CFGR = RCC_CFGR_APB1_DIV4 | RCC_CFGR_APB2_DIV2;
    RCC_CFGR |= RCC_CFGR_SW_PLL;
    if (!comes(&RCC_CFGR, RCC_CFGR_SWS, RCC_CFGR_SWS_PLL)) {
        return (clocks){8000000u, 8000000u}; /* behind the dividers of 16 MHz; timers get twice 4 */
    }
    return (clocks){84000000u, 84000000u};
}

/* ---- Who we are --------------------------------------------------------------------------- */

static abt_reset_cause reset_cause(void)
{
    const uint32_t flags = RCC_CSR;
    RCC_CSR |= RCC_CSR_RMVF; /* or they pile up */
    if (flags & (RCC_CSR_IWDGRSTF | RCC_CSR_WWDGRSTF)) {
        return ABT_RESET_CAUSE_WATCHDOG;
    }
    if (flags & RCC_CSR_SFTRSTF) {
        return ABT_RESET_CAUSE_SOFTWARE;
    }
    if (flags & RCC_CSR_PORRSTF) { /* power-on sets the two below as well */
        return ABT_RESET_CAUSE_POWER_ON;
    }
    if (flags & RCC_CSR_BORRSTF) {
        return ABT_RESET_CAUSE_BROWN_OUT;
    }
    return flags & RCC_CSR_PINRSTF ? ABT_RESET_CAUSE_PIN : ABT_RESET_CAUSE_UNKNOWN;
}

/* From the random generator, and from what RAM held: differs after every boot also if the generator
 * does not work. */
static uint32_t new_boot_nonce(void)
{
    static struct {
        uint32_t count;
        uint32_t noise[15];
    } kept __attribute__((section(".keep")));
    RCC_AHB2ENR |= RCC_AHB2ENR_RNG;
    RNG_CR = RNG_CR_RNGEN;
    kept.count++;
    kept.noise[0] ^= comes(&RNG_SR, RNG_SR_DRDY, RNG_SR_DRDY) ? RNG_DR : 0;
    kept.noise[1] = abt_crc32((const uint8_t *)&kept, sizeof kept);
    return kept.noise[1];
}

/* ---- Sensors ------------------------------------------------------------------------------ */

static void start_sensors(void)
{
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOA;
    RCC_APB2ENR |= RCC_APB2ENR_ADC1;
    GPIOA_MODER |= (3u << 8) | (3u << 10); /* PA4, PA5 analog */
    ADC_CCR = ADC_CCR_PCLK_DIV4;
    ADC1_CR1 = ADC_CR1_SCAN | ADC_CR1_JAUTO;
    ADC1_SMPR2 = (4u << 12) | (4u << 15); /* 84 cycles each: a pair every 10 us or so */
    ADC1_SQR3 = 4u;
    ADC1_JSQR = (1u << 20) | (4u << 10) | (5u << 15); /* two: the supply, then the pressure */
    ADC1_CR2 = ADC_CR2_ADON | ADC_CR2_CONT;
    ADC1_CR2 |= ADC_CR2_SWSTART; /* from now on the data registers hold the newest */
}

static abt_sensors read_sensors(void)
{
    const uint32_t supply = ADC1_JDR1 & 4095u, pressure = ADC1_JDR2 & 4095u;
    return (abt_sensors){
        .supply_mv = (uint16_t)(supply * SUPPLY_FULL_MV / 4095u),
        .supply_pa = (uint32_t)((uint64_t)pressure * PRESSURE_FULL_PA / 4095u),
    };
}

/* ---- Serial line -------------------------------------------------------------------------- */

static void start_line(uint32_t usart_hz)
{
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOA;
    RCC_APB2ENR |= RCC_APB2ENR_USART1;
    GPIOA_AFRH |= (7u << 4) | (7u << 8); /* PA9, PA10: USART1 */
    GPIOA_PUPDR |= 1u << 20; /* an open line is at rest, not a stream of noise */
    GPIOA_MODER |= (2u << 18) | (2u << 20);
    USART1_BRR = (usart_hz + BAUD / 2u) / BAUD;
    USART1_CR1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    /* Above the alarm: a byte waits in one register until the next is complete, 347 cycles later on
     * the internal oscillator, and the alarm's interrupt takes ten times as many. */
    NVIC_IPR(USART1_IRQ) = LINE_PRIORITY;
    NVIC_ISER(USART1_IRQ) = NVIC_BIT(USART1_IRQ);
}

/* As much as the line takes now; the interrupt goes on with the rest. */
static void send_on(void)
{
    while (to_send.out != to_send.in && (USART1_SR & USART_SR_TXE)) {
        USART1_DR = to_send.bytes[to_send.out % SEND_MAX];
        to_send.out++;
    }
    if (to_send.out == to_send.in) {
        USART1_CR1 &= ~USART_CR1_TXEIE;
    } else {
        USART1_CR1 |= USART_CR1_TXEIE;
    }
}

void USART1_IRQHandler(void)
{
    if (USART1_SR & (USART_SR_RXNE | USART_SR_ORE)) {
        received.stamp_us = timer_now_us();
    }
    while (USART1_SR & (USART_SR_RXNE | USART_SR_ORE)) {
        const uint8_t byte = (uint8_t)USART1_DR; /* clears both; a byte lost is a bad CRC */
        if (received.in - received.out < RECEIVE_MAX) {
            received.bytes[received.in % RECEIVE_MAX] = byte;
            received.in++;
        }
    }
    send_on();
}

/* ---- Critical section and alarm ----------------------------------------------------------- */

/* Keeps the alarm away, and not the line's interrupt, which shares nothing with the core. */
static void enter(void *context)
{
    (void)context;
    __asm__ volatile("msr basepri, %0" ::"r"(ALARM_PRIORITY) : "memory");
}

static void leave(void *context)
{
    (void)context;
    __asm__ volatile("msr basepri, %0" ::"r"(0) : "memory");
}

void timer_alarm(void)
{
    const abt_outputs outputs = abt_run(&firmware, timer_now_us(), read_sensors());
    board_drive(outputs.mask, outputs.bearing);
    runs++;
    timer_set_alarm(outputs.wake_us);
}

/* ---- Main loop ---------------------------------------------------------------------------- */

static void hear(void)
{
    static uint8_t bytes[RECEIVE_MAX];
    uint32_t count = 0;
    for (uint32_t out = received.out; out != received.in; out++) {
        bytes[count++] = received.bytes[out % RECEIVE_MAX];
    }
    const uint32_t stamp_us = received.stamp_us;
    received.out += count;
    if (count > 0 && abt_receive(&firmware, stamp_us, bytes, count)) {
        timer_trigger();
    }
}

static void talk(void)
{
    uint8_t frame[ABT_FRAME_MAX];
    while (SEND_MAX - (to_send.in - to_send.out) >= ABT_FRAME_MAX) {
        const uint32_t size = abt_transmit(&firmware, timer_now_us(), frame);
        if (size == 0) {
            return;
        }
        for (uint32_t i = 0; i < size; i++) {
            to_send.bytes[(to_send.in + i) % SEND_MAX] = frame[i];
        }
        to_send.in += size;
        __asm__ volatile("cpsid i" ::: "memory"); /* the line's interrupt sends, too */
        send_on();
        __asm__ volatile("cpsie i" ::: "memory");
    }
}

int main(void)
{
    const abt_reset_cause cause = reset_cause();
    const clocks rates = start_clocks();
    const abt_identity identity = {ABT_FIRMWARE_ID, new_boot_nonce(), cause};
    start_sensors();
    abt_init(&firmware, &BOARD_CONFIG, &identity, (abt_port){enter, leave, NULL}, 0);
    timer_start(rates.timer_hz);
    start_line(rates.usart_hz);
    timer_trigger();
    for (uint32_t seen = 0;;) {
        hear();
        talk();
        if (runs != seen) { /* fed only while the alarm and this loop are both alive */
            seen = runs;
            IWDG_KR = IWDG_KR_FEED;
        }
        __asm__ volatile("cpsid i" ::: "memory");
        if (received.in == received.out && runs == seen) {
            /* wakes although interrupts are off, so that none is slept over */
            __asm__ volatile("wfi\n\tcpsie i\n\tisb" ::: "memory");
        }
        __asm__ volatile("cpsie i" ::: "memory");
    }
}
