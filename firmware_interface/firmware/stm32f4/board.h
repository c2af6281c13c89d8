/* Board file: what is soldered to which pin. This one is for STM32F405 boards whose port C is free,
 * the class of Olimex's STM32-H405 and the Netduino Plus 2; change it for yours.
 *
 *     V0..V7        PC0..PC7, high opens; pull-downs at the gate drivers
 *     bearing air   PC8, high is on; pull-down at its driver
 *     host          USART1, PA9 (to the host) and PA10
 *     supply        PA4 through a divider
 *     pressure      PA5
 */
#ifndef BOARD_H
#define BOARD_H

#include "registers.h"

/* Of the crystal; must be a whole number of MHz. With a wrong one the baud rate is wrong, too, and
 * the board cannot be armed. */
#ifndef CRYSTAL_MHZ
#define CRYSTAL_MHZ 8u
#endif

#define BAUD 460800u

/* All on one port, so that one store drives them all. */
#define VALVE_PINS 0x00ffu
#define BEARING_PIN 0x0100u
#define OUTPUT_MODES 0x00015555u /* two bits per pin, 01 is output */

/* At 4095 counts; assumed: 10:1 divider, 0..1 MPa transducer scaled to 3.3 V. */
#define SUPPLY_FULL_MV 33000u
#define PRESSURE_FULL_PA 1000000u

/* One store to the pins: nothing in between is ever seen outside. */
static inline void board_drive(uint8_t mask, _Bool bearing)
{
    const uint32_t high = mask | (bearing ? BEARING_PIN : 0u);
    const uint32_t low = (VALVE_PINS | BEARING_PIN) & ~high;
    GPIOC_BSRR = high | (low << 16);
}

/* First thing after any reset, before memory is set up: low first, then outputs. */
static inline void board_close_everything(void)
{
    RCC_AHB1ENR |= RCC_AHB1ENR_GPIOC;
    (void)RCC_AHB1ENR; /* RM0090: the clock needs two cycles */
    board_drive(0, 0);
    GPIOC_MODER = OUTPUT_MODES;
}

/* In a fault bearing air stays as it is; see docs/firmware.md. */
static inline void board_close_valves(void)
{
    GPIOC_BSRR = VALVE_PINS << 16;
}

#endif
