// The twin of heaps.
#define FLIP_HEAPS
#include "twin.cpp"
