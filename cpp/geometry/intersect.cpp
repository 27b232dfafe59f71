#include "geometry/intersect.h"
