/* The registers this port uses. Names and addresses: ST, RM0090 (STM32F405 reference manual) and
 * PM0214 (Cortex-M4 programming manual). */
#ifndef REGISTERS_H
#define REGISTERS_H

#include <stdint.h>

#define REG(address) (*(volatile uint32_t *)(uintptr_t)(address))

#define RCC_CR REG(0x40023800u)
#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_CSSON (1u << 19)
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)
#define RCC_PLLCFGR REG(0x40023804u)
#define RCC_PLLCFGR_SRC_HSE (1u << 22)
#define RCC_CFGR REG(0x40023808u)
#define RCC_CFGR_SW_PLL 2u
#define RCC_CFGR_SWS (3u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_APB1_DIV4 (5u << 10)
#define RCC_CFGR_APB2_DIV2 (4u << 13)
#define RCC_AHB1ENR REG(0x40023830u)
#define RCC_AHB1ENR_GPIOA (1u << 0)
#define RCC_AHB1ENR_GPIOC (1u << 2)
#define RCC_AHB2ENR REG(0x40023834u)
#define RCC_AHB2ENR_RNG (1u << 6)
#define RCC_APB1ENR REG(0x40023840u)
#define RCC_APB1ENR_TIM2 (1u << 0)
#define RCC_APB2ENR REG(0x40023844u)
#define RCC_APB2ENR_USART1 (1u << 4)
#define RCC_APB2ENR_ADC1 (1u << 8)
#define RCC_CSR REG(0x40023874u)
#define RCC_CSR_RMVF (1u << 24)
#define RCC_CSR_BORRSTF (1u << 25)
#define RCC_CSR_PINRSTF (1u << 26)
#define RCC_CSR_PORRSTF (1u << 27)
#define RCC_CSR_SFTRSTF (1u << 28)
#define RCC_CSR_IWDGRSTF (1u << 29)
#define RCC_CSR_WWDGRSTF (1u << 30)

#define FLASH_ACR REG(0x40023c00u)
#define FLASH_ACR_5_WAITS_CACHES (5u | (1u << 8) | (1u << 9) | (1u << 10))

#define GPIOA_MODER REG(0x40020000u)
#define GPIOA_PUPDR REG(0x4002000cu)
#define GPIOA_AFRH REG(0x40020024u)
#define GPIOC_MODER REG(0x40020800u)
#define GPIOC_BSRR REG(0x40020818u)

#define IWDG_KR REG(0x40003000u)
#define IWDG_KR_FEED 0xaaaau
#define IWDG_KR_UNLOCK 0x5555u
#define IWDG_KR_START 0xccccu
#define IWDG_PR REG(0x40003004u)
#define IWDG_RLR REG(0x40003008u)

#define TIM2_CR1 REG(0x40000000u)
#define TIM2_CR1_CEN (1u << 0)
#define TIM2_CR1_URS (1u << 2)
#define TIM2_DIER REG(0x4000000cu)
#define TIM2_DIER_CC1IE (1u << 1)
#define TIM2_SR REG(0x40000010u)
#define TIM2_SR_CC1IF (1u << 1)
#define TIM2_EGR REG(0x40000014u)
#define TIM2_EGR_UG (1u << 0)
#define TIM2_EGR_CC1G (1u << 1)
#define TIM2_CNT REG(0x40000024u)
#define TIM2_PSC REG(0x40000028u)
#define TIM2_ARR REG(0x4000002cu)
#define TIM2_CCR1 REG(0x40000034u)
#define TIM2_IRQ 28u

#define USART1_SR REG(0x40011000u)
#define USART_SR_ORE (1u << 3)
#define USART_SR_RXNE (1u << 5)
#define USART_SR_TXE (1u << 7)
#define USART1_DR REG(0x40011004u)
#define USART1_BRR REG(0x40011008u)
#define USART1_CR1 REG(0x4001100cu)
#define USART_CR1_RE (1u << 2)
#define USART_CR1_TE (1u << 3)
#define USART_CR1_RXNEIE (1u << 5)
#define USART_CR1_TXEIE (1u << 7)
#define USART_CR1_UE (1u << 13)
#define USART1_IRQ 37u

#define ADC1_CR1 REG(0x40012004u)
#define ADC_CR1_SCAN (1u << 8)
#define ADC_CR1_JAUTO (1u << 10)
#define ADC1_CR2 REG(0x40012008u)
#define ADC_CR2_ADON (1u << 0)
#define ADC_CR2_CONT (1u << 1)
#define ADC_CR2_SWSTART (1u << 30)
#define ADC1_SMPR2 REG(0x40012010u)
#define ADC1_SQR3 REG(0x40012034u)
#define ADC1_JSQR REG(0x40012038u)
#define ADC1_JDR1 REG(0x4001203cu)
#define ADC1_JDR2 REG(0x40012040u)
#define ADC_CCR REG(0x40012304u)
#define ADC_CCR_PCLK_DIV4 (1u << 16)

#define RNG_CR REG(0x50060800u)
#define RNG_CR_RNGEN (1u << 2)
#define RNG_SR REG(0x50060804u)
#define RNG_SR_DRDY (1u << 0)
#define RNG_DR REG(0x50060808u)

#define SYSTICK_CSR REG(0xe000e010u)
#define SYSTICK_CSR_ENABLE (1u << 0)
#define SYSTICK_CSR_TICKINT (1u << 1)
#define SYSTICK_CSR_CORE_CLOCK (1u << 2)
#define SYSTICK_RVR REG(0xe000e014u)
#define SYSTICK_CVR REG(0xe000e018u)

#define NVIC_ISER(irq) REG(0xe000e100u + 4u * ((irq) / 32u))
#define NVIC_ISPR(irq) REG(0xe000e200u + 4u * ((irq) / 32u))
#define NVIC_BIT(irq) (1u << ((irq) % 32u))
#define NVIC_IPR(irq) (*(volatile uint8_t *)(uintptr_t)(0xe000e400u + (irq)))
#define SCB_SYSTICK_PRIORITY (*(volatile uint8_t *)(uintptr_t)0xe000ed23u)
#define SCB_ICSR REG(0xe000ed04u)
#define SCB_ICSR_PENDSTSET (1u << 26)

#endif
