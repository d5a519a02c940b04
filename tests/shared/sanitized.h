/* Whether a test runs under AddressSanitizer or ThreadSanitizer, which make programs several times as slow, and take most of the address space. */
#ifndef TROCAR_SANITIZED_H
#define TROCAR_SANITIZED_H

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1
#else
#define SANITIZED 0
#endif

#endif
