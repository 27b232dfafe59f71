#include "kernels/mrf.h"
