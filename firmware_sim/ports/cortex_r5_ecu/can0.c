/* can0.c -- see can0.h; registers: Zynq UltraScale+ Devices Register Reference (UG1087), module CAN. */
#include "can0.h"

#include "filter.h"

#define CAN0(offset) (*(volatile uint32_t*)(0xFF060000u + (offset)))

enum {
    SRR = 0x00,
    MSR = 0x04,
    BRPR = 0x08,
    BTR = 0x0C,
    SR = 0x18,
    ISR = 0x1C,
    ICR = 0x24,
    TX = 0x30,
    RX = 0x50,
    AFR = 0x60,
    ID = 0x0,
    DLC = 0x4,
    DATA1 = 0x8,
    DATA2 = 0xC /* of TX and RX */
};
static const uint32_t software_reset = 1u << 0, enable = 1u << 1, tx_full = 1u << 10, rx_not_empty = 1u << 7;

/* Each access to a register takes QEMU's single lock. On one processor, a tight loop would keep it from the input thread. */
static void leave_the_lock(void) {
    volatile int idle;
    for (idle = 0; idle < 2000; ++idle) {
    }
}

static uint32_t packed(const uint8_t* data) { return data[0] | (uint32_t)data[1] << 8 | (uint32_t)data[2] << 16 | (uint32_t)data[3] << 24; }

static void unpack(uint32_t word, uint8_t* data) {
    size_t i;
    for (i = 0u; i < 4u; ++i) {
        data[i] = (uint8_t)(word >> (8u * i));
    }
}

static bool take_frame(lpvg_can_frame_t* frame) {
    if ((CAN0(ISR) & rx_not_empty) == 0u) {
        return false;
    }
    frame->id = CAN0(RX + ID); /* reading advances the queue */
    frame->dlc = (uint8_t)(CAN0(RX + DLC) >> 28);
    unpack(CAN0(RX + DATA1), &frame->data[0]);
    unpack(CAN0(RX + DATA2), &frame->data[4]);
    CAN0(ICR) = rx_not_empty; /* set again while more frames wait */
    return true;
}

static bool send_frame(void* driver, const lpvg_can_frame_t* frame) {
    can0_t* const self = (can0_t*)driver;
    if (self->bus_off || frame->dlc > sizeof frame->data || (CAN0(SR) & tx_full) != 0u) {
        return false;
    }
    CAN0(TX + ID) = frame->id;
    CAN0(TX + DLC) = (uint32_t)frame->dlc << 28;
    CAN0(TX + DATA1) = packed(&frame->data[0]);
    CAN0(TX + DATA2) = packed(&frame->data[4]); /* sends */
    ++self->sent;
    return true;
}

static bool receive_frame(void* driver, int64_t now_us, lpvg_can_frame_t* frame) {
    can0_t* const self = (can0_t*)driver;
    bool off;
    if (self->bus_off && now_us - self->bus_off_us >= CAN0_RESTART_US) {
        self->bus_off = false;
    }
    off = self->bus_off;
    while (self->head != self->tail) {
        *frame = self->queue[self->tail++ % CAN0_QUEUE];
        frame->t_us = now_us;
        if (!off && (frame->id & LPVG_CAN_ERROR) != 0u && (frame->id & LPVG_CAN_BUS_OFF) != 0u) {
            self->bus_off = true; /* the report is passed on */
            self->bus_off_us = now_us;
        }
        if (!off) {
            return true;
        }
    }
    return false;
}

void can0_open(can0_t* self, bus_t* bus) {
    self->also = 0u;
    self->head = self->tail = 0u;
    self->sent = 0u;
    self->bus_off = false;
    CAN0(SRR) = software_reset;
    CAN0(BRPR) = 1u; /* the model has no bit timing */
    CAN0(BTR) = 0x1Cu;
    CAN0(MSR) = 0u;
    CAN0(AFR) = 0u;
    CAN0(SRR) = enable;
    bus->driver = self;
    bus->send_frame = send_frame;
    bus->receive_frame = receive_frame;
}

void can0_await(can0_t* self, uint64_t frames) {
    lpvg_can_frame_t frame;
    while (frames > 0u) {
        if (!take_frame(&frame)) {
            leave_the_lock();
        } else if (filter_passes(&frame) || (self->also != 0u && frame.id == self->also)) {
            --frames;
            if (self->head - self->tail < CAN0_QUEUE) {
                self->queue[self->head++ % CAN0_QUEUE] = frame;
            }
        }
    }
}
