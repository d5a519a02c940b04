# End-to-end tests of the programs over LCM, each in a private network namespace. Skipped (77) where namespaces are not permitted.
set(netns ${PROJECT_SOURCE_DIR}/scripts/netns)
add_test(NAME end_to_end COMMAND ${witness} ${netns} ${CMAKE_CURRENT_SOURCE_DIR}/end_to_end.sh
    $<TARGET_FILE:trocar-server> $<TARGET_FILE:trocar-device> ${PROJECT_SOURCE_DIR}/meshes/figure8.yaml)
if(TROCAR_SANITIZE)
    set(timing no) # instrumented programs are many times slower, so only their messages are checked
else()
    set(timing yes)
endif()
set_tests_properties(end_to_end PROPERTIES ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 240 ${alone})

# Fault injection into a running server (partly through wrapped functions), and a killed server.
foreach(test faults restart)
    add_executable(${test} ${test}.c)
    target_link_libraries(${test} PRIVATE trocar_service trocar_core trocar_types PkgConfig::CMOCKA m)
    target_compile_definitions(${test} PRIVATE MESHES="${PROJECT_SOURCE_DIR}/meshes")
endforeach()
target_link_options(faults PRIVATE -Wl,--wrap=clock_gettime,--wrap=remesher_serve,--wrap=trocar_sim_tick,--wrap=coupling_hold)
add_test(NAME faults COMMAND ${witness} ${netns} $<TARGET_FILE:faults>)
set_tests_properties(faults PROPERTIES LABELS release_only) # instrumented ticks take almost their period: they are late on a busy machine
add_test(NAME restart COMMAND ${witness} ${netns} $<TARGET_FILE:restart> ${PROJECT_SOURCE_DIR}/scripts/keep_alive $<TARGET_FILE:trocar-server>)
if(TROCAR_SANITIZE STREQUAL "thread") # a server restarts more slowly than the test waits
    set_tests_properties(restart PROPERTIES LABELS release_only)
endif()
set_tests_properties(faults restart PROPERTIES
    ENVIRONMENT "TROCAR_CHECK_TIMING=${timing}" SKIP_RETURN_CODE 77 TIMEOUT 240 ${alone})

# The library that connects a device, against a live server.
add_executable(device_client device_client.c)
target_link_libraries(device_client PRIVATE trocar_client trocar_types trocar_service PkgConfig::CMOCKA m)
target_compile_definitions(device_client PRIVATE MESHES="${PROJECT_SOURCE_DIR}/meshes")
add_test(NAME device_client COMMAND ${witness} ${netns} $<TARGET_FILE:device_client> $<TARGET_FILE:trocar-server>)
set_tests_properties(device_client PROPERTIES SKIP_RETURN_CODE 77 TIMEOUT 120 ${alone} LABELS release_only) # a sanitized server is too slow to give forces in time

add_test(NAME condense COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_condense.sh $<TARGET_FILE:trocar-server> ${PROJECT_SOURCE_DIR}/meshes)

# Restart after a fault; the systemd unit, if systemd runs.
add_test(NAME keep_alive COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_keep_alive.sh ${PROJECT_SOURCE_DIR}/scripts/keep_alive)
set_tests_properties(keep_alive PROPERTIES LABELS release_only)
add_test(NAME systemd_unit COMMAND ${CMAKE_CURRENT_SOURCE_DIR}/test_unit.sh ${PROJECT_SOURCE_DIR}/scripts/packaging/trocar-server.service.in
    $<TARGET_FILE:trocar-server>)
set_tests_properties(systemd_unit PROPERTIES LABELS release_only)
