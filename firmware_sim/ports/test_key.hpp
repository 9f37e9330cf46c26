// The public key of the simulation, which only shows that both ends work. A vehicle's key is in its security module.
#pragma once

#include "aes_cmac.hpp"
#include "firmware.h"

inline const firmware_key_t* test_key() {
    constexpr uint8_t key[16] = {0x2b, 0x7e, 0x15, 0x16, 0x28, 0xae, 0xd2, 0xa6, 0xab, 0xf7, 0x15, 0x88, 0x09, 0xcf, 0x4f, 0x3c};
    static AesCmac cmac(key);
    static const firmware_key_t made = {AesCmac::hook, &cmac, 0U};
    return &made;
}
