/* TIM2 counts microseconds, its compare register 1 is the alarm. */
#include "timer.h"

#include "registers.h"

void TIM2_IRQHandler(void);

void timer_start(uint32_t timer_hz)
{
    RCC_APB1ENR |= RCC_APB1ENR_TIM2;
    TIM2_CR1 = TIM2_CR1_URS;
    TIM2_PSC = timer_hz / 1000000u - 1u;
    TIM2_ARR = 0xffffffffu;
    TIM2_EGR = TIM2_EGR_UG; /* take the prescaler over; count from 0 */
    TIM2_SR = 0;
    TIM2_DIER = TIM2_DIER_CC1IE;
    TIM2_CR1 = TIM2_CR1_URS | TIM2_CR1_CEN;
    NVIC_IPR(TIM2_IRQ) = ALARM_PRIORITY;
    NVIC_ISER(TIM2_IRQ) = NVIC_BIT(TIM2_IRQ);
}

uint32_t timer_now_us(void)
{
    return TIM2_CNT;
}

void timer_set_alarm(uint32_t wake_us)
{
    TIM2_CCR1 = wake_us;
    if (TIM2_CNT - wake_us < 0x80000000u) {
        TIM2_EGR = TIM2_EGR_CC1G; /* the counter may have passed it before it was written */
    }
}

void timer_trigger(void)
{
    NVIC_ISPR(TIM2_IRQ) = NVIC_BIT(TIM2_IRQ);
    __asm__ volatile("dsb\n\tisb" ::: "memory"); /* it has been taken when this returns */
}

void TIM2_IRQHandler(void)
{
    TIM2_SR = ~TIM2_SR_CC1IF;
    timer_alarm();
}
