# find_package(trocar COMPONENTS library client types):
#   trocar::trocar  simulation library: #include <trocar.h>
#   trocar::client  connects a device to the server: #include <trocar_client.h>
#   trocar::client_unicast  the same, also for udp://HOST:PORT; needs nettle. Only if the component client_unicast is given
#   trocar::types   C bindings of the messages: #include "trocar_needle_pose_t.h"
# The others if no component is given.
if(NOT trocar_FIND_COMPONENTS)
    set(trocar_FIND_COMPONENTS library client types)
endif()
set(trocar_FOUND TRUE)
foreach(component ${trocar_FIND_COMPONENTS})
    include(CMakeFindDependencyMacro)
    if(component STREQUAL client)
        find_dependency(Threads)
        include(${CMAKE_CURRENT_LIST_DIR}/trocar-client.cmake)
    elseif(component STREQUAL client_unicast)
        find_dependency(Threads)
        include(${CMAKE_CURRENT_LIST_DIR}/trocar-unicast.cmake)
    elseif(component STREQUAL types)
        find_dependency(PkgConfig)
        pkg_check_modules(LCM REQUIRED IMPORTED_TARGET lcm)
        include(${CMAKE_CURRENT_LIST_DIR}/trocar-types.cmake)
    elseif(component STREQUAL library)
        include(${CMAKE_CURRENT_LIST_DIR}/trocar-library.cmake)
    else()
        set(trocar_FOUND FALSE)
        set(trocar_NOT_FOUND_MESSAGE "trocar has no component ${component}; components: library, client, client_unicast, types")
        return()
    endif()
    set(trocar_${component}_FOUND TRUE)
endforeach()
