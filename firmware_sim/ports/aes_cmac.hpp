// AES-128-CMAC (FIPS 197, NIST SP 800-38B) for simulation and tests, and to measure the cost of authentication without hardware. Its time
// depends on the key through the S-box. An ECU needs its own module or a suitable library behind the hook of authentication.h.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

class AesCmac {
public:
    explicit AesCmac(const uint8_t (&key)[16]) {
        std::memcpy(round_key_, key, sizeof key);
        uint8_t round_constant = 1U;
        for (std::size_t i = 16U; i < sizeof round_key_; i += 4U) {
            uint8_t word[4];
            std::memcpy(word, &round_key_[i - 4U], sizeof word);
            if (i % 16U == 0U) {
                const uint8_t first = word[0];
                word[0] = static_cast<uint8_t>(box().entry[word[1]] ^ round_constant);
                word[1] = box().entry[word[2]];
                word[2] = box().entry[word[3]];
                word[3] = box().entry[first];
                round_constant = twice(round_constant);
            }
            for (std::size_t j = 0U; j < 4U; ++j) {
                round_key_[i + j] = static_cast<uint8_t>(round_key_[i + j - 16U] ^ word[j]);
            }
        }
    }

    void encrypt(uint8_t (&block)[16]) const {
        add(block, &round_key_[0]);
        for (std::size_t round = 1U; round <= 10U; ++round) {
            uint8_t shifted[16];
            for (std::size_t i = 0U; i < 16U; ++i) {
                shifted[i] = box().entry[block[(i + 4U * (i % 4U)) % 16U]];
            }
            for (std::size_t c = 0U; c < 16U; c += 4U) {
                const uint8_t* const s = &shifted[c];
                const auto all = static_cast<uint8_t>(s[0] ^ s[1] ^ s[2] ^ s[3]);
                for (std::size_t i = 0U; i < 4U; ++i) {
                    const auto mixed = static_cast<uint8_t>(s[i] ^ all ^ twice(static_cast<uint8_t>(s[i] ^ s[(i + 1U) % 4U])));
                    block[c + i] = round < 10U ? mixed : s[i];
                }
            }
            add(block, &round_key_[16U * round]);
        }
    }

    void mac(const uint8_t* data, std::size_t n, uint8_t (&out)[16]) const {
        uint8_t subkey[16] = {};
        encrypt(subkey);
        shift(subkey);
        const bool whole = n > 0U && n % 16U == 0U;
        if (!whole) {
            shift(subkey);
        }
        std::memset(out, 0, sizeof out);
        std::size_t done = 0U;
        for (; n - done > 16U; done += 16U) {
            add(out, &data[done]);
            encrypt(out);
        }
        uint8_t last[16] = {};
        std::memcpy(last, &data[done], n - done);
        if (!whole) {
            last[n - done] = 0x80U;
        }
        add(out, last);
        add(out, subkey);
        encrypt(out);
    }

    // Has the type lpvg_can_cmac_t; context is the object.
    static bool hook(void* context, const uint8_t* data, std::size_t n, uint8_t mac[16]) {
        uint8_t out[16];
        static_cast<const AesCmac*>(context)->mac(data, n, out);
        std::memcpy(mac, out, sizeof out);
        return true;
    }

private:
    static constexpr uint8_t twice(uint8_t x) { return static_cast<uint8_t>((uint32_t{x} << 1U) ^ ((x & 0x80U) != 0U ? 0x1BU : 0U)); }

    // Computes the inverse in GF(2^8), then the affine map. Powers of 3 run through the field, and powers of 1/3 through the inverses.
    struct Box {
        uint8_t entry[256];
        constexpr Box() : entry() {
            uint8_t p = 1U, q = 1U;
            do {
                p = static_cast<uint8_t>(p ^ twice(p));
                q = static_cast<uint8_t>(q ^ (q << 1U));
                q = static_cast<uint8_t>(q ^ (q << 2U));
                q = static_cast<uint8_t>(q ^ (q << 4U));
                q = static_cast<uint8_t>(q ^ ((q & 0x80U) != 0U ? 0x09U : 0U));
                uint8_t sum = q;
                for (unsigned k = 1U; k <= 4U; ++k) {
                    sum = static_cast<uint8_t>(sum ^ (q << k) ^ (q >> (8U - k)));
                }
                entry[p] = static_cast<uint8_t>(sum ^ 0x63U);
            } while (p != 1U);
            entry[0] = 0x63U;
        }
    };
    static const Box& box() {
        static constexpr Box made;
        return made;
    }

    static void add(uint8_t (&to)[16], const uint8_t* what) {
        for (std::size_t i = 0U; i < 16U; ++i) {
            to[i] = static_cast<uint8_t>(to[i] ^ what[i]);
        }
    }

    // Multiplies by x in GF(2^128).
    static void shift(uint8_t (&block)[16]) {
        const bool carry = (block[0] & 0x80U) != 0U;
        for (std::size_t i = 0U; i < 15U; ++i) {
            block[i] = static_cast<uint8_t>((block[i] << 1U) | (block[i + 1U] >> 7U));
        }
        block[15] = static_cast<uint8_t>((uint32_t{block[15]} << 1U) ^ (carry ? 0x87U : 0U));
    }

    uint8_t round_key_[176];
};
