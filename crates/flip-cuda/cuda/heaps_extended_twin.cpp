// The twin of heaps whose grains turn.
#define FLIP_HEAPS
#define FLIP_EXTENDED
#include "twin.cpp"
