#include "kernels/skeleton.h"
