/* A stand-in for ESP-IDF's header. */
#pragma once
void esp_system_abort(const char *details) __attribute__((noreturn));
